/* The gate's board on simavr: runs the firmware's binary cycle by cycle, as orders on standard input say.

   gate_board FIRMWARE.elf

   An order is a line, `<order> <cycle> <arguments>`; it is carried out at the first instruction from that cycle on:

     beam CYCLE 0|1              the sensor's level, 1 while a stone closes the beam
     receive CYCLE HEX           a byte from the host
     memory CYCLE ADDRESS HEX    write to the working memory
     eeprom CYCLE ADDRESS HEX    write to the EEPROM
     reset CYCLE                 pull the reset line, as DTR does
     hang CYCLE                  the program hangs, interrupts go on
     run CYCLE                   no order comes before this cycle; answered by `ran` and the bytes of the EEPROM

   What the board does is told by lines, the answer to `run` last: `sent CYCLE HEX` for each byte to the host, and
   `pin CYCLE NAME 0|1` for beam, trigger, strobe and lamp, at the cycle at which the level changed. */

#include <simavr/avr_eeprom.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_timer.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <simavr/sim_time.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { DDRB = 0x24, BEAM = 0, TRIGGER = 1, STROBE = 2, LAMP = 5, RJMP_SELF = 0xCFFF, KEPT = 32 };

static avr_t *avr;
static avr_timer_t *timer; /* 1 */
static int levels[8];
static const char *names[8] = {[BEAM] = "beam", [TRIGGER] = "trigger", [STROBE] = "strobe", [LAMP] = "lamp"};

static void tell_level(int pin, int level)
{
    if (level != levels[pin])
        printf("pin %llu %s %d\n", (unsigned long long)avr->cycle, names[pin], levels[pin] = level);
}

static void on_lamp(struct avr_irq_t *irq, uint32_t value, void *unused)
{
    (void)irq, (void)unused;
    tell_level(LAMP, value & 1);
}

/* The compare units of simavr 1.6 also switch when the timer overflows or is set, which no chip does in this mode. */
static void on_compare(struct avr_irq_t *irq, uint32_t value, void *pin)
{
    (void)irq;
    int number = (int)(intptr_t)pin;
    uint64_t due = timer->comp[number - TRIGGER].comp_cycles;
    if (avr->cycle - timer->tov_base >= due || due == timer->tov_cycles)
        tell_level(number, value & 1 && avr->data[DDRB] >> number & 1);
}

static void on_byte(struct avr_irq_t *irq, uint32_t value, void *unused)
{
    (void)irq, (void)unused;
    printf("sent %llu %02x\n", (unsigned long long)avr->cycle, value);
}

static avr_cycle_count_t wake(avr_t *unused, avr_cycle_count_t when, void *param)
{
    (void)unused, (void)when, (void)param;
    return 0; /* it was only to end the sleep */
}

static void no_sleep(avr_t *unused, avr_cycle_count_t cycles)
{
    (void)unused, (void)cycles; /* emulated time passes as fast as it can */
}

static void run_until(unsigned long long cycle)
{
    if (cycle > avr->cycle)
        avr_cycle_timer_register(avr, cycle - avr->cycle, wake, NULL);
    while (avr->cycle < cycle) {
        int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) {
            fprintf(stderr, "the firmware crashed at cycle %llu\n", (unsigned long long)avr->cycle);
            exit(1);
        }
        if (!avr->data[DDRB] && cycle > avr->cycle) { /* reset, perhaps by the watchdog: the timers are gone as well */
            avr_cycle_timer_register(avr, cycle - avr->cycle, wake, NULL);
            for (int pin = TRIGGER; pin < 8; pin++)
                tell_level(pin, 0);
        }
    }
}

static void set_beam(int level)
{
    avr_ioport_external_t pull = {.name = 'B', .mask = 1 << BEAM, .value = level << BEAM};
    avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL('B'), &pull); /* else the pull-up wins with each write to the port */
    avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), BEAM), level);
    tell_level(BEAM, level);
}

static void hang(void)
{
    avr->pc = avr->flashend - 1;
    avr->flash[avr->pc] = RJMP_SELF & 0xFF;
    avr->flash[avr->pc + 1] = RJMP_SELF >> 8;
    avr->state = cpu_Running;
}

static int unhex(const char *hex, uint8_t *bytes)
{
    int n = 0;
    for (unsigned byte; sscanf(hex + 2 * n, "%2x", &byte) == 1; n++)
        bytes[n] = byte;
    return n;
}

static void obey(const char *order, unsigned long long cycle, const char *first, const char *second)
{
    static uint8_t bytes[4096];
    run_until(cycle);
    if (!strcmp(order, "beam")) {
        set_beam(atoi(first));
    } else if (!strcmp(order, "receive")) {
        avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT), strtoul(first, NULL, 16));
    } else if (!strcmp(order, "memory")) {
        int n = unhex(second, bytes);
        memcpy(avr->data + strtoul(first, NULL, 0), bytes, n);
    } else if (!strcmp(order, "eeprom")) {
        avr_eeprom_desc_t written = {.ee = bytes, .offset = strtoul(first, NULL, 0), .size = unhex(second, bytes)};
        avr_ioctl(avr, AVR_IOCTL_EEPROM_SET, &written);
    } else if (!strcmp(order, "reset")) {
        avr_reset(avr);
        set_beam(levels[BEAM]);
    } else if (!strcmp(order, "hang")) {
        hang();
    } else if (!strcmp(order, "run")) {
        avr_eeprom_desc_t kept = {.ee = bytes, .offset = 0, .size = KEPT};
        avr_ioctl(avr, AVR_IOCTL_EEPROM_GET, &kept);
        printf("ran %llu ", (unsigned long long)avr->cycle);
        for (int i = 0; i < KEPT; i++)
            printf("%02x", bytes[i]);
        printf("\n");
        fflush(stdout);
    } else {
        fprintf(stderr, "no order: %s\n", order);
        exit(2);
    }
}

int main(int argc, char **argv)
{
    static elf_firmware_t firmware;
    if (argc != 2 || elf_read_firmware(argv[1], &firmware))
        return 2;
    avr = avr_make_mcu_by_name("atmega328p");
    avr_init(avr);
    firmware.frequency = 16000000;
    avr_load_firmware(avr, &firmware);
    avr->sleep = no_sleep;
    avr->log = LOG_ERROR;
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
    flags &= ~(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POLL_SLEEP);
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte, NULL);
    for (avr_io_t *io = avr->io_port; io; io = io->next)
        if (!strcmp(io->kind, "timer") && ((avr_timer_t *)io)->name == '1')
            timer = (avr_timer_t *)io;
    for (intptr_t unit = 0; unit < 2; unit++)
        avr_irq_register_notify(timer->io.irq + TIMER_IRQ_OUT_COMP + unit, on_compare, (void *)(TRIGGER + unit));
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), LAMP), on_lamp, NULL);
    set_beam(0);

    static char line[16384], order[16], first[8192], second[8192];
    unsigned long long cycle;
    while (fgets(line, sizeof line, stdin)) {
        first[0] = second[0] = '\0';
        if (sscanf(line, "%15s %llu %8191s %8191s", order, &cycle, first, second) < 2)
            return 2;
        obey(order, cycle, first, second);
    }
    return 0;
}
