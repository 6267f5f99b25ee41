/* A wireless link in user space: passes Ethernet frames between pairs of nodes, late and with losses.

   usage: emulator [-s SEED] [-l LOSS] [-o OUTLIERS] [-f FROM_US] [-u OUTLIER_US] [-q QUICK] [-a AFTER_US]
                   [-i IDLE_US] NAMESPACE LINK...

   LINK is four words: the device of one end, that of the other, each as NODE/DEVICE, and the delays of frames
   that the first and that the second end receives: LAW,MINIMUM_US[,MEAN_US,SHAPE[,WAIT_US,QUICK_US]]. A device is a virtual cable
   from the node's network namespace to NAMESPACE, of the same name there.

     constant   the minimum
     gamma      minimum + Gamma(SHAPE), of that mean in all
     lognormal  minimum + lognormal, SHAPE is its sigma, of that mean in all
     rare       minimum + WAIT_US + Gamma(SHAPE), of that mean in all; at quick moments minimum + exponential of
                mean QUICK_US

   -l and -o are shares: of frames lost, and of frames that are late by FROM_US to OUTLIER_US more; -q is that of
   quick moments, which a link of law "rare" has from AFTER_US on since it began, both ways at once. A link
   begins anew when it was idle for longer than IDLE_US. Frames of a
   direction keep their order. Every direction has a random generator of its own, so that its n-th frame is
   drawn the same delay in every run of the same SEED.

   Says "ready" on stdout when it passes frames; on SIGTERM or SIGINT prints a line of JSON for each direction
   with what it did, those to a link's first end before those to its second, and ends. It ends with its parent. */

#define _GNU_SOURCE
#include <errno.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

#include "delay_laws.h"
#include "link_ends.h"

enum { MAX_LINKS = 16, QUEUE_FRAMES = 1024, FRAMES_A_TURN = 64, WORDS_A_LINK = 4 };
enum { PRIORITY = 50 };
/* A process wakes up tens of microseconds late, so the last part of each wait is spent awake. */
enum { AWAKE_NS = 60000, LATE_NS = 100000 };

struct direction {
    int from, to; /* packet sockets */
    struct law law;
    struct moments *link;
    struct frame *queue;
    unsigned first, waiting;
    int64_t last_due_ns;
    /* What it did. */
    uint64_t frames, lost, outliers, quick, overflowed, unsent, held_back, passed, late;
    double drawn_sum_us, drawn_least_us, late_sum_us, late_most_us;
};

static double loss, outlier_share, outlier_from_us, outlier_us = 20000.0;
static volatile sig_atomic_t stopped;

/* Frames */

static void send_frame(struct direction *d, const struct frame *frame)
{
    if (send(d->to, frame->data, (size_t)frame->bytes, 0) != frame->bytes)
        d->unsent++;
}

/* Let a frame that was just read wait for its time, at the end of the queue. */
static void take_frame(struct direction *d, struct frame *frame, int64_t arrived_ns)
{
    d->frames++;
    if (uniform(&d->law) < loss) {
        d->lost++;
        return;
    }
    bool quick = d->law.quick_us > 0.0 && is_quick(d->link, arrived_ns);
    double delay_us = d->law.minimum_us + (quick ? quick_excess(&d->law) : d->law.excess_us(&d->law));
    d->quick += quick;
    d->drawn_sum_us += delay_us;
    d->drawn_least_us = fmin(d->drawn_least_us, delay_us);
    if (uniform(&d->law) < outlier_share) {
        d->outliers++;
        delay_us += outlier_from_us + (outlier_us - outlier_from_us) * uniform(&d->law);
    }
    frame->due_ns = arrived_ns + llround(delay_us * 1000.0);
    if (d->waiting && frame->due_ns < d->last_due_ns) {
        d->held_back++;
        frame->due_ns = d->last_due_ns;
    }
    d->last_due_ns = frame->due_ns;
    d->waiting++;
}

/* Read what has come, in place at the end of the queue; where that is full, a frame is lost. */
static void read_frames(struct direction *d)
{
    static struct frame spare;
    for (int i = 0; i < FRAMES_A_TURN; i++) {
        bool full = d->waiting == QUEUE_FRAMES;
        struct frame *frame = full ? &spare : &d->queue[(d->first + d->waiting) % QUEUE_FRAMES];
        int64_t arrived_ns = read_frame(d->from, frame);
        if (frame->bytes <= 0)
            return;
        if (full)
            d->overflowed++;
        else
            take_frame(d, frame, arrived_ns);
    }
}

/* Send what is due; return when the next is, or INT64_MAX. */
static int64_t send_due(struct direction *d)
{
    while (d->waiting) {
        struct frame *frame = &d->queue[d->first];
        int64_t late_ns = now_ns() - frame->due_ns;
        if (late_ns < 0)
            return frame->due_ns;
        send_frame(d, frame);
        d->passed++;
        d->late += late_ns > LATE_NS;
        d->late_sum_us += (double)late_ns / 1000.0;
        d->late_most_us = fmax(d->late_most_us, (double)late_ns / 1000.0);
        d->first = (d->first + 1) % QUEUE_FRAMES;
        d->waiting--;
    }
    return INT64_MAX;
}

static void pass_frames(struct direction *directions, nfds_t count, const sigset_t *while_waiting)
{
    struct pollfd readable[2 * MAX_LINKS];
    for (nfds_t i = 0; i < count; i++)
        readable[i] = (struct pollfd){.fd = directions[i].from, .events = POLLIN};
    while (!stopped) {
        int64_t due_ns = INT64_MAX;
        for (nfds_t i = 0; i < count; i++) {
            int64_t next_ns = send_due(&directions[i]);
            due_ns = next_ns < due_ns ? next_ns : due_ns;
        }
        int64_t wait_ns = due_ns - AWAKE_NS - now_ns();
        wait_ns = wait_ns < 0 ? 0 : wait_ns;
        struct timespec wait = {wait_ns / 1000000000, wait_ns % 1000000000};
        if (ppoll(readable, count, due_ns == INT64_MAX ? NULL : &wait, while_waiting) < 0 && errno != EINTR)
            fail("waiting for", "frames");
        for (nfds_t i = 0; i < count; i++)
            if (readable[i].revents)
                read_frames(&directions[i]);
    }
}

/* The program */

static void stop(int signal_number)
{
    (void)signal_number;
    stopped = 1;
}

static bool become_urgent(void)
{
    struct sched_param priority = {.sched_priority = PRIORITY};
    prctl(PR_SET_TIMERSLACK, 1UL);
    mlockall(MCL_CURRENT | MCL_FUTURE);
    return sched_setscheduler(0, SCHED_FIFO, &priority) == 0;
}

static void report(const struct direction *d, int link, bool urgent)
{
    uint64_t drawn = d->frames - d->lost;
    printf("{\"link\": %d, \"real_time\": %s, \"frames\": %lu, \"lost\": %lu, \"outliers\": %lu, \"quick\": %lu, ",
           link, urgent ? "true" : "false", d->frames, d->lost, d->outliers, d->quick);
    printf("\"held_back\": %lu, \"overflowed\": %lu, \"unsent\": %lu, \"late_by_100_us\": %lu, ",
           d->held_back, d->overflowed, d->unsent, d->late);
    printf("\"drawn_mean_us\": %.2f, \"drawn_least_us\": %.2f, \"late_mean_us\": %.2f, \"late_most_us\": %.2f}\n",
           drawn ? d->drawn_sum_us / (double)drawn : 0.0, drawn ? d->drawn_least_us : 0.0,
           d->passed ? d->late_sum_us / (double)d->passed : 0.0, d->late_most_us);
}

int main(int argc, char **argv)
{
    static struct direction directions[2 * MAX_LINKS];
    static struct moments moments[MAX_LINKS];
    uint64_t seed = 1;
    for (int option; (option = getopt(argc, argv, "s:l:o:f:u:q:a:i:")) != -1;) {
        switch (option) {
        case 's': seed = strtoull(optarg, NULL, 10); break;
        case 'l': loss = atof(optarg); break;
        case 'o': outlier_share = atof(optarg); break;
        case 'f': outlier_from_us = atof(optarg); break;
        case 'u': outlier_us = atof(optarg); break;
        case 'q': quick_share = atof(optarg); break;
        case 'a': quick_after_ns = llround(atof(optarg) * 1000.0); break;
        case 'i': idle_ns = llround(atof(optarg) * 1000.0); break;
            default: return 2;
        }
    }
    int words = argc - optind - 1, links = words / WORDS_A_LINK;
    if (words <= 0 || words % WORDS_A_LINK || links > MAX_LINKS) {
        fprintf(stderr, "emulator: a namespace, and 1 to %d links of %d words each\n", MAX_LINKS, WORDS_A_LINK);
        return 2;
    }
    const char *namespace = argv[optind];
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    for (int link = 0; link < links; link++) {
        char **word = argv + optind + 1 + WORDS_A_LINK * link;
        struct direction *to_first = &directions[2 * link], *to_second = to_first + 1;
        to_first->to = to_second->from = open_end(namespace, word[0]);
        to_second->to = to_first->from = open_end(namespace, word[1]);
        to_first->link = to_second->link = &moments[link];
        moments[link].random_state = seed + (uint64_t)link * UINT64_C(0xd1342543de82ef95);
        errno = 0;
        if (!read_law(&to_first->law, word[2]) || !read_law(&to_second->law, word[3]))
            fail("delays of link", word[0]);
    }
    for (int i = 0; i < 2 * links; i++) {
        uint64_t mixed = seed;
        directions[i].law.random_state = random_bits(&mixed) + random_bits(&(uint64_t){(uint64_t)i});
        directions[i].drawn_least_us = HUGE_VAL;
        directions[i].queue = calloc(QUEUE_FRAMES, sizeof(struct frame));
        if (!directions[i].queue)
            fail("memory for", "frames");
    }
    struct sigaction ending = {.sa_handler = stop};
    sigset_t blocked, before;
    sigemptyset(&blocked);
    sigaddset(&blocked, SIGTERM);
    sigaddset(&blocked, SIGINT);
    sigprocmask(SIG_BLOCK, &blocked, &before);
    sigaction(SIGTERM, &ending, NULL);
    sigaction(SIGINT, &ending, NULL);
    bool urgent = become_urgent();
    puts("ready");
    fflush(stdout);
    pass_frames(directions, (nfds_t)(2 * links), &before);
    for (int i = 0; i < 2 * links; i++)
        report(&directions[i], i / 2, urgent);
    return 0;
}
