// SPDX-License-Identifier: Apache-2.0
// prompt.c - see prompt.h.
#include "prompt.h"

#include <sched.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

enum { NICE = -10 };

enum prompt prompt_me(int priority)
{
    prctl(PR_SET_TIMERSLACK, 1);
    // Threads that are started from here on get the usual scheduling again.
    if (priority > 0 && sched_setscheduler(0, SCHED_FIFO | SCHED_RESET_ON_FORK, &(struct sched_param){ .sched_priority = priority }) == 0)
        return PROMPT_REALTIME;
    // On Linux this is of the thread, not of the process.
    return setpriority(PRIO_PROCESS, (id_t)gettid(), NICE) == 0 ? PROMPT_NICE : PROMPT_USUAL;
}

void prompt_mutex_init(pthread_mutex_t *m)
{
    pthread_mutexattr_t a;
    pthread_mutexattr_init(&a);
    pthread_mutexattr_setprotocol(&a, PTHREAD_PRIO_INHERIT);
    pthread_mutex_init(m, &a);
    pthread_mutexattr_destroy(&a);
}
