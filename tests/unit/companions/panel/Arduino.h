// What the sketch uses of an ATmega328P, for the host's compiler: its SPI, with the panel's registers on it, and ports.
#include <stdint.h>
#include <stdio.h>

#define F_CPU 16000000UL
#define _BV(bit) (1 << (bit))
#define ISR(vector) void vector()
enum { PB1 = 1, PB2, PB3, PB4, PB5 };
enum { SPE = 6, MSTR = 4, DORD = 5, CPOL = 3, CPHA = 2, SPI2X = 0, SPIF = 7 };
enum { WGM12 = 3, CS11 = 1, OCIE1A = 1, OCF1A = 1 };
static uint8_t DDRB, SPCR, TCCR1A = 1, TCCR1B = 3, TIFR1, TIMSK0 = 1, TIMSK1;
static uint16_t TCNT1 = 99, OCR1A;
static bool interrupts_on = true;
inline void noInterrupts() { interrupts_on = false; }
inline void interrupts() { interrupts_on = true; }

static uint64_t chain, outputs;  // of the registers: what was shifted in, and what the last edge of RCK took over

struct {
  uint8_t value;
  void set(uint8_t to) {
    if (!(value & _BV(PB2)) && (to & _BV(PB2))) outputs = chain;
    value = to;
  }
  void operator|=(int bits) { set(value | bits); }
  void operator&=(int bits) { set(value & bits); }
} PORTB;

struct {
  void operator=(uint8_t bits) {
    const bool is_master = SPCR == (_BV(SPE) | _BV(MSTR)) && (DDRB & _BV(PB2)) && (DDRB & _BV(PB3)) && (DDRB & _BV(PB5));
    if (is_master) chain = chain << 8 | bits;
  }
} SPDR;

struct {
  operator uint8_t() { return _BV(SPIF); }
  void operator=(uint8_t) {}
} SPSR;
