// Runs the sketch tick by tick; prints the timer's set-up, then what the registers' outputs drive.
#include "Arduino.h"
#include "panel.ino"

#include <stdlib.h>

static void show() { printf("%012llx\n", PORTB.value & _BV(PB1) ? 0ULL : (unsigned long long)outputs); }

int main(int, char **arguments) {
  setup();
  const bool is_running = interrupts_on && TIMSK1 == _BV(OCIE1A) && TCCR1A == 0 && TCCR1B == (_BV(WGM12) | _BV(CS11));
  printf("%d %d %d\n", is_running, TIMSK0, OCR1A);
  show();
  for (long tick = atol(arguments[1]); tick > 0; tick--) {
    TIMER1_COMPA_vect();
    show();
  }
}
