/* For LD_PRELOAD: a rank that waits for others sleeps between two looks, where Open MPI asks it to yield. One that
   yields gets its turn again behind all else that wants a core, at every message; one that wakes up gets it at once.
   The longer it has waited, the longer it sleeps, as each look takes time from those it waits for. */
#include <time.h>

#define LOOKS 20       /* in a row before it sleeps, in which messages come where cores are free */
#define WORK 4000      /* ns between two looks, in which something else was done: it waits for another message */
#define SHORTEST 20000 /* ns of sleep */
#define LONGEST 300000
#define PART 16        /* it sleeps for a 16th of what it has waited */

static long nanoseconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000000000L + now.tv_nsec;
}

int sched_yield(void) {
    static __thread long first, last, looks;
    long now = nanoseconds();
    if (now - last > WORK) {
        first = now;
        looks = 0;
    }
    if (++looks > LOOKS) {
        long sleep = (now - first) / PART;
        if (sleep < SHORTEST) sleep = SHORTEST;
        if (sleep > LONGEST) sleep = LONGEST;
        nanosleep(&(struct timespec){0, sleep}, 0);
    }
    last = nanoseconds();
    return 0;
}
