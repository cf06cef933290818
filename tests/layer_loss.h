/* SPDX-License-Identifier: Apache-2.0 */
/*
 * layer_loss.h - what a test asks of the Vulkan layer in layer_loss.c, and what that has seen: a file of this size, which
 * AIRY_LAYER_LOSS names, mapped by both. All zero: everything goes through.
 *
 * The layer is an implicit one, which AIRY_LAYER_LOSS_ON=1 turns on: for those that VK_INSTANCE_LAYERS names the loader warns an
 * application that wants to hear of warnings, and airyd --validate takes any as a failure.
 *
 * Every count of faults is used up by the calls that get them; whoever sets one reads it again to know that they came.
 */
#ifndef TEST_LAYER_LOSS_H
#define TEST_LAYER_LOSS_H

#include <stdatomic.h>
#include <stdint.h>

#define LAYER_LOSS_ON "AIRY_LAYER_LOSS_ON"
#define LAYER_LOSS_FILE "AIRY_LAYER_LOSS"

struct layer_loss {
    _Atomic uint32_t hold;  /* while it is not 0 submissions stand still, as in a driver that hangs */
    _Atomic uint32_t hold_idle; /* while it is not 0 vkDeviceWaitIdle stands still */
    _Atomic uint32_t spare; /* so many first submissions of each device neither fail nor stand still */
    /* So many calls more fail, and how. */
    _Atomic uint32_t submit_lost; /* vkQueueSubmit2: VK_ERROR_DEVICE_LOST, not submitted */
    _Atomic uint32_t wait_lost;   /* vkWaitSemaphores: VK_ERROR_DEVICE_LOST, of work that is under way */
    _Atomic uint32_t wait_hung;   /* vkWaitSemaphores: VK_TIMEOUT, without the time */
    _Atomic uint32_t create_fails; /* vkCreateDevice: VK_ERROR_INITIALIZATION_FAILED */
    /* Seen so far, in all processes. */
    _Atomic uint32_t devices;   /* opened */
    _Atomic uint32_t destroyed;
    _Atomic uint32_t submitted; /* came for the device, whatever became of them */
    _Atomic uint32_t held;      /* calls that stand still now */
};

#endif
