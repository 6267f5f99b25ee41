// simulshot: the LED panel @name@, for an Arduino Uno or Nano (ATmega328P, 16 MHz).
//
// Each array lights one of its ten columns for a fixed number of ticks, then the next; in the row below, each of the
// ten LEDs is lit ten times as long. WIRING.md lists the parts and the wires.
//
// Timer 1 counts the ticks in hardware (clear on compare match), so delays do not accumulate. The remaining errors are
// the interrupt latency (a quarter of a microsecond) and the board's oscillator.

const uint16_t TICK_US = @tick_us@;
const uint8_t ARRAYS = @arrays@;
const uint8_t TICKS[ARRAYS] = {@ticks@};  // ticks for which each array's columns are lit

static_assert(F_CPU == 16000000UL, "the timer's clock below is for 16 MHz");
static_assert(TICK_US >= 100 && TICK_US <= 32000, "shorter ticks end before the LEDs are set, longer ones overflow");

// Port B: D9 /G (outputs off while high), D10 RCK (outputs follow its rising edge), D11 SER IN, D13 SRCK.
const uint8_t OFF = _BV(PB1), LATCH = _BV(PB2), DATA = _BV(PB3), CLOCK = _BV(PB5);
const uint16_t END = 1 << 10;

struct Array {
  uint16_t columns, row;  // one bit of ten each
  uint8_t left;           // ticks until the next column
};
static Array arrays[ARRAYS];

static void send(uint8_t bits) {
  SPDR = bits;
  while (!(SPSR & _BV(SPIF))) {
  }
}

// Three registers per array; the byte sent first ends up at the end of the chain.
static void sendAll() {
  for (uint8_t i = ARRAYS; i-- > 0;) {
    uint16_t columns = arrays[i].columns, row = arrays[i].row;
    send(row >> 6);
    send((uint8_t)(row << 2) | (uint8_t)(columns >> 8));
    send((uint8_t)columns);
  }
}

static void step() {
  for (uint8_t i = 0; i < ARRAYS; i++) {
    Array &one = arrays[i];
    if (--one.left) continue;
    one.left = TICKS[i];
    one.columns <<= 1;
    if (one.columns != END) continue;
    one.columns = 1;
    one.row <<= 1;
    if (one.row == END) one.row = 1;
  }
}

static void latch() {
  PORTB |= LATCH;
  PORTB &= ~LATCH;
}

ISR(TIMER1_COMPA_vect) {
  latch();  // first: output what was shifted in during the last tick, without delay
  step();
  sendAll();
}

void setup() {
  PORTB |= OFF;
  DDRB |= OFF | LATCH | DATA | CLOCK;
  SPCR = _BV(SPE) | _BV(MSTR);  // mode 0, high bit first
  SPSR = _BV(SPI2X);            // half the processor's clock: 8 MHz
  sendAll();                    // all bits are still 0
  latch();
  PORTB &= ~OFF;
  for (uint8_t i = 0; i < ARRAYS; i++) arrays[i] = {1, 1, TICKS[i]};
  sendAll();

  noInterrupts();
  TIMSK0 = 0;  // the interrupt of millis() would delay ours
  TCCR1A = 0;
  TCCR1B = 0;
  TCNT1 = 0;
  OCR1A = TICK_US * 2 - 1;  // in half microseconds
  TIFR1 = _BV(OCF1A);
  TIMSK1 = _BV(OCIE1A);
  TCCR1B = _BV(WGM12) | _BV(CS11);  // clear on compare match, an eighth of the clock
  interrupts();
}

void loop() {}
