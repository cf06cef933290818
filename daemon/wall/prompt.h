/* SPDX-License-Identifier: Apache-2.0 */
/* prompt.h - threads that must run when their time has come: ahead of others on the same cores, as far as the system allows. */
#ifndef AIRYD_PROMPT_H
#define AIRYD_PROMPT_H

#include <pthread.h>

enum prompt { PROMPT_REALTIME, PROMPT_NICE, PROMPT_USUAL };

/* The calling thread: FIFO at this real-time priority where that is allowed, else nice -10 where that is, else as it was. 0: nice at
 * best, which threads that it starts inherit (real-time priority they do not). Timer slack goes in any case. */
enum prompt prompt_me(int priority);
/* A mutex that real-time threads wait for, too: who holds it must not be kept from the processor by a third. */
void prompt_mutex_init(pthread_mutex_t *m);

#endif
