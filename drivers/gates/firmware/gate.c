/* The light gate: an Arduino Nano or Uno (ATmega328P, 16 MHz) that speaks drivers/gates/gate_protocol.py.

   D8   input    the sensor: low while light arrives; high, by the pull-up, while the beam is closed or the wire is off
   D9   output   the cameras' trigger, high for the pulse
   D10  output   the strobe: the same pulse at the same cycle
   D13  output   the board's lamp, on while the beam is closed
   D0, D1        the serial line: the board's USB, 115200 baud

   Timer 1 counts cycles of the crystal. Its capture unit notes the cycle of an edge and its compare unit switches the
   outputs at the cycle that is due, so that an interrupt that comes late moves neither. Cycles are kept as 32 bits,
   which wrap after 268 s: they are compared by their differences, and made into the protocol's microseconds of 64
   bits while they are young. README.md beside this file says how to wire it and how to flash it. */

#include <avr/boot.h>
#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <util/atomic.h>
#include <util/crc16.h>
#include <util/delay.h>

#define NAME "stonefall-gate"
#define VERSION "1.0" /* FIRMWARE_VERSION in drivers/gates/gate_protocol.py; raise both with each change */

#define CYCLES_A_US (F_CPU / 1000000UL)
#define DEBOUNCE_US 1000UL       /* a beam that closes again sooner was closed by the same stone */
#define LEAST_US 60              /* of a delay and of a pulse: longer than interrupts can hold each other up */
#define LONGEST_PULSE_US 900     /* shorter than DEBOUNCE_US: pulses of two stones never overlap */
#define LONGEST_DELAY_US 2000000 /* far less than the 134 s within which cycles can be compared */
#define PLACES 16                /* pulses that wait at the same time; a power of two, as all queues here */

#define BEAM _BV(PB0)
#define TRIGGER _BV(PB1)
#define STROBE _BV(PB2)
#define LAMP _BV(PB5)

/* --- the clock; these functions, and all down to the interrupts, are called with interrupts off --- */

static volatile uint32_t turns; /* overflows of the timer */
static volatile uint32_t eras;  /* overflows of `turns`, one in 203 days */

/* Return the cycle at which the timer stood at `low`, less than half a turn ago. */
static uint32_t cycle_of(uint16_t low)
{
    uint16_t turn = turns;
    if ((TIFR1 & _BV(TOV1)) && low < 0x8000)
        turn++; /* its interrupt is pending */
    return (uint32_t)turn << 16 | low;
}

static uint32_t cycle_now(void)
{
    return cycle_of(TCNT1);
}

/* Return whether `cycle` is less than `ahead` away, or past. */
static bool is_within(uint32_t cycle, uint32_t ahead)
{
    return (int32_t)(cycle - cycle_now()) < (int32_t)ahead;
}

/* --- pulses: a queue by time, whose first the compare unit makes --- */

#define SETTING 160 /* more cycles than it takes to set the compare unit */

static struct setting {
    uint32_t delay_us;
    uint16_t pulse_us, crc; /* of the two, where it is kept */
} setting;

static volatile uint32_t unmade; /* pulses for which no place was free */
static uint32_t waiting[PLACES];
static uint8_t first, n_waiting;
static uint32_t match; /* the cycle of the match that switches the outputs */

enum output {
    LOW = 0,
    FALLING = _BV(COM1A1) | _BV(COM1B1), /* high, the next match lowers them */
    RISING = FALLING | _BV(COM1A0) | _BV(COM1B0)
};

static void set_match(uint32_t cycle)
{
    if (is_within(cycle, SETTING))
        cycle = cycle_now() + SETTING;
    match = cycle;
    OCR1A = (uint16_t)cycle;
    OCR1B = (uint16_t)cycle;
}

/* Prepare the first pulse; one that is more than a turn of the timer away is prepared again after each turn. */
static void prepare(void)
{
    TCCR1A = LOW;
    if (!n_waiting)
        return;
    set_match(waiting[first]);
    if (is_within(match, UINT16_MAX))
        TCCR1A = RISING;
}

/* Plan a pulse. One that would begin before the end of another comes right after that, late. */
static void add_pulse(uint32_t cycle)
{
    if (n_waiting == PLACES) {
        unmade++;
        return;
    }
    bool is_first_rising = TCCR1A == RISING && is_within(match, SETTING);
    if (!n_waiting || (!is_first_rising && (int32_t)(cycle - waiting[first]) < 0)) {
        first = (first + PLACES - 1) % PLACES;
        waiting[first] = cycle;
        n_waiting++;
        if (TCCR1A != FALLING)
            prepare();
        return;
    }
    uint8_t place = n_waiting++;
    for (; place > 1; place--) { /* those that come later move on */
        uint32_t before = waiting[(first + place - 1) % PLACES];
        if ((int32_t)(cycle - before) >= 0)
            break;
        waiting[(first + place) % PLACES] = before;
    }
    waiting[(first + place) % PLACES] = cycle;
}

ISR(TIMER1_COMPA_vect)
{
    bool is_switched = is_within(match, 1);
    if (TCCR1A == RISING && is_switched) {
        first = (first + 1) % PLACES;
        n_waiting--;
        TCCR1A = FALLING;
        set_match(match + setting.pulse_us * CYCLES_A_US);
    } else if (TCCR1A == LOW || is_switched) {
        prepare();
    }
}

/* --- the beam --- */

#define EVENTS 32

struct event {
    char letter; /* of its record */
    uint32_t cycle, sequence;
};

static struct event events[EVENTS];
static volatile uint8_t events_end, events_start;
static volatile uint32_t sequence, ignored;
static enum { OPEN, CLOSED, OPENING } beam; /* OPENING: open for less than the debounce time */
static uint32_t opened;
static bool is_width_owed;

/* Note what a line is to tell. With `events` full it is lost: the host sees that from the next number. */
static bool note(char letter, uint32_t cycle)
{
    uint8_t end = (events_end + 1) % EVENTS;
    if (end == events_start)
        return false;
    events[events_end] = (struct event){letter, cycle, sequence};
    events_end = end;
    return true;
}

/* The beam has been open for the debounce time: the stone's width is certain. */
static void settle(uint32_t now)
{
    if (beam != OPENING || now - opened < DEBOUNCE_US * CYCLES_A_US)
        return;
    beam = OPEN;
    if (is_width_owed)
        note('W', opened);
    is_width_owed = false;
}

/* Make a pulse after the delay, give it a number, and have its line sent. */
static bool count(char letter, uint32_t cycle)
{
    add_pulse(cycle + (setting.delay_us < LEAST_US ? LEAST_US : setting.delay_us) * CYCLES_A_US);
    settle(cycle);
    sequence++;
    return note(letter, cycle);
}

static void take_edge(uint32_t cycle)
{
    TCCR1B ^= _BV(ICES1); /* capture the opposite edge next */
    if (TIFR1 & _BV(ICF1))
        TIFR1 = _BV(ICF1);
    if (beam == CLOSED) {
        beam = OPENING;
        opened = cycle;
        PORTB &= ~LAMP;
        return;
    }
    if (beam == OPENING && cycle - opened < DEBOUNCE_US * CYCLES_A_US)
        ignored++;
    else
        is_width_owed = count('E', cycle);
    beam = CLOSED;
    PORTB |= LAMP;
}

static bool is_changed(void)
{
    return (beam == CLOSED) != !!(PINB & BEAM);
}

ISR(TIMER1_CAPT_vect)
{
    uint32_t cycle = cycle_of(ICR1);
    if (is_changed())
        take_edge(cycle);
    else if (beam != CLOSED)
        ignored++; /* over before its interrupt: no stone */
    if (is_changed()) /* once more, before the capture unit looked for it */
        take_edge(cycle_now());
}

ISR(TIMER1_OVF_vect)
{
    if (!++turns)
        eras++;
    if (is_changed() && !(TIFR1 & _BV(ICF1)))
        take_edge(cycle_now()); /* an edge that came while the capture unit was turned to it */
    settle(cycle_now());
}

/* --- the serial line: queues that interrupts empty and fill, so that nothing waits for it --- */

#define LONGEST_LINE 64
#define RECEIVED 64

static char sent[256];
static volatile uint8_t sent_end, sent_start; /* wrap by themselves */
static volatile char received[RECEIVED];
static volatile uint8_t received_end, received_start;

ISR(USART_UDRE_vect)
{
    if (sent_start == sent_end)
        UCSR0B &= ~_BV(UDRIE0);
    else
        UDR0 = sent[sent_start++];
}

ISR(USART_RX_vect)
{
    bool is_damaged = UCSR0A & (_BV(FE0) | _BV(DOR0));
    char byte = UDR0;
    uint8_t end = (received_end + 1) % RECEIVED;
    if (end == received_start)
        return;
    received[received_end] = is_damaged ? '\0' : byte;
    received_end = end;
}

/* --- lines to the host; from here on interrupts are on --- */

static uint8_t line_end;
static uint16_t line_crc;

static void put(char byte)
{
    sent[line_end++] = byte;
    line_crc = _crc_xmodem_update(line_crc, byte);
}

static void put_text(const char *text)
{
    while (*text)
        put(*text++);
}

static void begin(char letter)
{
    line_end = sent_end;
    put('$');
    line_crc = 0xFFFF;
    put(letter);
}

static void put_digits(uint32_t number, uint8_t least)
{
    char digits[11];
    ultoa(number, digits, 10);
    for (uint8_t n = strlen(digits); n < least; n++)
        put('0');
    put_text(digits);
}

/* In parts of nine digits, as a division of 64 bits takes long. */
static void field(uint64_t number)
{
    const uint32_t billion = 1000000000;
    uint32_t parts[3];
    uint8_t n = 0;
    do
        parts[n++] = number % billion;
    while (number /= billion);
    put(',');
    put_digits(parts[--n], 1);
    while (n)
        put_digits(parts[--n], 9);
}

static void put_hex(uint8_t byte)
{
    static const char digits[] = "0123456789ABCDEF";
    put(digits[byte >> 4]);
    put(digits[byte & 0xF]);
}

static void end(void)
{
    uint16_t crc = line_crc;
    put('*');
    put_hex(crc >> 8);
    put_hex(crc);
    put_text("\r\n");
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        sent_end = line_end;
        UCSR0B |= _BV(UDRIE0);
    }
}

static bool is_identity_owed, is_status_owed, is_setting_owed;
static uint32_t last_told, unmade_told, status_due; /* number of the last line, of the last D; cycle of the next S */
static uint8_t serial[10];

struct moment {
    uint32_t cycle, turns, eras;
};

#define THIS_MOMENT ((struct moment){cycle_now(), turns, eras}) /* with interrupts off */

/* Return the microseconds since power-on of a cycle that is at most 268 s older than `now`. */
static uint64_t microseconds(uint32_t cycle, struct moment now)
{
    uint64_t turn = (uint64_t)now.eras << 32 | now.turns;
    turn += (uint16_t)((uint16_t)(now.cycle >> 16) - (uint16_t)turn); /* 1 if an overflow was pending */
    turn -= (uint16_t)((uint16_t)(now.cycle >> 16) - (uint16_t)(cycle >> 16));
    return (turn << 12) + (uint16_t)cycle / CYCLES_A_US;
}

static void tell_event(void)
{
    static uint64_t closed_us; /* of the stone whose width comes next */
    static uint32_t closed_by;
    struct event event = events[events_start];
    struct moment now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { now = THIS_MOMENT; }
    uint64_t us = microseconds(event.cycle, now);
    events_start = (events_start + 1) % EVENTS;
    begin(event.letter);
    if (event.letter == 'W') {
        field(closed_by);
        field(us - closed_us);
    } else {
        field(last_told = event.sequence);
        field(us);
        if (event.letter == 'E') {
            closed_by = event.sequence;
            closed_us = us;
        }
    }
    end();
}

static void tell_identity(void)
{
    begin('I');
    put_text("," NAME ",");
    for (uint8_t i = 0; i < sizeof serial; i++)
        put_hex(serial[i]);
    put_text("," VERSION);
    end();
}

static void tell_setting(void)
{
    begin('D');
    field(setting.delay_us);
    field(setting.pulse_us);
    field(PLACES);
    field(unmade_told);
    end();
}

/* The numbers up to `last` have been told or lost: those that wait in `events` come later. */
static void tell_status(void)
{
    struct moment now;
    uint32_t n_ignored;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        if (events_start == events_end)
            last_told = sequence;
        now = THIS_MOMENT;
        n_ignored = ignored;
    }
    begin('S');
    field(microseconds(now.cycle, now));
    field(last_told);
    field(n_ignored);
    field(beam == CLOSED);
    end();
}

/* Send one line, if there is one and room for it; return whether there was. Edges go before anything else. */
static bool tell(void)
{
    uint32_t n_unmade;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        n_unmade = unmade;
        if (is_within(status_due, 1)) {
            status_due += F_CPU;
            is_status_owed = true;
        }
    }
    if ((uint8_t)(sent_start - sent_end - 1) < LONGEST_LINE)
        return false;
    if (events_start != events_end) {
        tell_event();
    } else if (is_identity_owed) {
        is_identity_owed = false;
        tell_identity();
    } else if (is_setting_owed || n_unmade != unmade_told) {
        is_setting_owed = false;
        unmade_told = n_unmade;
        tell_setting();
    } else if (is_status_owed) {
        is_status_owed = false;
        tell_status();
    } else {
        return false;
    }
    return true;
}

/* --- delay and width, kept over power-off --- */

#define KEPT ((struct setting *)16) /* in the EEPROM; away from 0, which a brown-out writes to first */

static uint16_t crc_of(const void *start, uint8_t length)
{
    uint16_t crc = 0xFFFF;
    for (const uint8_t *byte = start; length--; byte++)
        crc = _crc_xmodem_update(crc, *byte);
    return crc;
}

static bool is_possible(const struct setting *one)
{
    return (one->delay_us == 0 || one->delay_us >= LEAST_US) && one->delay_us <= LONGEST_DELAY_US &&
           one->pulse_us >= LEAST_US && one->pulse_us <= LONGEST_PULSE_US;
}

static void read_setting(void)
{
    eeprom_read_block(&setting, KEPT, sizeof setting);
    if (setting.crc != crc_of(&setting, offsetof(struct setting, crc)) || !is_possible(&setting))
        setting = (struct setting){.delay_us = 0, .pulse_us = 100};
}

static void change_setting(struct setting changed)
{
    if (!is_possible(&changed))
        return;
    changed.crc = crc_of(&changed, offsetof(struct setting, crc));
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { setting = changed; }
    eeprom_update_block(&changed, KEPT, sizeof changed); /* up to 27 ms; interrupts go on */
}

/* --- commands of the host --- */

/* Read a number of at most seven digits; return where it ends, NULL if there is none. */
static const char *read_number(const char *text, uint32_t *number)
{
    const char *start = text;
    for (*number = 0; *text >= '0' && *text <= '9'; text++)
        *number = *number * 10 + (*text - '0');
    return text == start || text - start > 7 ? NULL : text;
}

static void obey_setting(const char *line)
{
    uint32_t delay, pulse;
    const char *text = read_number(line + strlen("$D,"), &delay);
    if (!text || *text != ',' || !(text = read_number(text + 1, &pulse)) || *text != '*' || pulse > UINT16_MAX)
        return;
    char *stop;
    uint16_t crc = strtoul(text + 1, &stop, 16);
    if (stop == text + 5 && !*stop && crc == crc_of(line + 1, text - line - 1))
        change_setting((struct setting){.delay_us = delay, .pulse_us = pulse});
}

static void obey(const char *line)
{
    if (!strcmp(line, "?")) {
        is_identity_owed = is_setting_owed = is_status_owed = true;
    } else if (!strcmp(line, "T")) {
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { count('T', cycle_now()); }
    } else if (!strncmp(line, "$D,", 3)) {
        obey_setting(line);
        is_setting_owed = true;
    }
}

/* Take one received byte, if there is one; return whether there was. */
static bool listen(void)
{
    static char line[LONGEST_LINE];
    static uint8_t length;
    if (received_start == received_end)
        return false;
    char byte = received[received_start];
    received_start = (received_start + 1) % RECEIVED;
    if (byte == '\n') {
        line[length] = '\0';
        length = 0;
        obey(line);
    } else {
        if (byte == '$')
            length = 0; /* half a line before it does not spoil it */
        if (length < LONGEST_LINE - 1)
            line[length++] = byte;
    }
    return true;
}

/* --- start --- */

/* After a reset by the watchdog it still runs, with its shortest time. */
__attribute__((naked, used, section(".init3"))) static void stop_watchdog(void)
{
    MCUSR = 0;
    wdt_disable();
}

static void start(void)
{
    PORTB = BEAM; /* pull-up */
    DDRB = TRIGGER | STROBE | LAMP;
    _delay_ms(1); /* the capacitance of a long wire */
    if (PINB & BEAM) {
        beam = CLOSED;
        PORTB |= LAMP;
    }
    for (uint8_t i = 0; i < sizeof serial; i++)
        serial[i] = boot_signature_byte_get(0x0E + i); /* lot, wafer and place of the die */
    read_setting();
    TCCR1B = _BV(ICNC1) | _BV(CS10) | (beam == CLOSED ? 0 : _BV(ICES1));
    TIFR1 = _BV(ICF1);
    TIMSK1 = _BV(ICIE1) | _BV(OCIE1A) | _BV(TOIE1);
    UCSR0A = _BV(U2X0);
    UBRR0 = 16; /* 117647 baud, 2.1 % fast, as every Arduino */
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXCIE0) | _BV(RXEN0) | _BV(TXEN0);
    status_due = F_CPU;
    set_sleep_mode(SLEEP_MODE_IDLE);
    wdt_enable(WDTO_500MS);
    sei();
}

int main(void)
{
    start();
    for (;;) {
        wdt_reset();
        bool was_told = tell();
        if (listen() || was_told)
            continue;
        cli();
        if (events_start == events_end && received_start == received_end) {
            sleep_enable();
            sei(); /* takes effect after the next instruction: no interrupt comes between */
            sleep_cpu();
            sleep_disable();
        }
        sei();
    }
}
