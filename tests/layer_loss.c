// SPDX-License-Identifier: Apache-2.0
// layer_loss.c - a Vulkan layer that passes everything on, but for the calls that a test wants to fail (layer_loss.h): so
// an unmodified daemon loses its device, or finds none, when the test says so. That cannot be had of a driver on command.
//
// The invariant: what a layer below has made is known here as long as it lives, and nothing of it is used after. A call that is
// to fail leaves the device as a real one would be left: work that was submitted goes on.
#include "layer_loss.h"

#include <fcntl.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include <vulkan/vk_layer.h>
#include <vulkan/vulkan.h>

#define EXPORT __attribute__((visibility("default")))

enum { LINKS_MAX = 16 };

// An instance or a device, found by what the loader writes at the start of every handle that belongs to it.
struct link {
    void *key; // NULL: free
    VkInstance instance;
    PFN_vkGetInstanceProcAddr instance_next;
    PFN_vkGetDeviceProcAddr device_next;
    PFN_vkQueueSubmit2 submit;
    PFN_vkWaitSemaphores wait;
    PFN_vkDeviceWaitIdle wait_idle;
    uint32_t submissions;
};

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static struct link links[LINKS_MAX];
static struct layer_loss nothing, *control;

static void *key_of(const void *handle)
{
    void *key;
    memcpy(&key, handle, sizeof key);
    return key;
}

static bool link_add(const struct link *l)
{
    bool found = false;
    pthread_mutex_lock(&lock);
    for (unsigned i = 0; i < LINKS_MAX && !found; i++)
        if (!links[i].key) {
            links[i] = *l;
            found = true;
        }
    pthread_mutex_unlock(&lock);
    return found;
}

static struct link *link_locked(const void *handle)
{
    for (unsigned i = 0; handle && i < LINKS_MAX; i++)
        if (links[i].key == key_of(handle))
            return &links[i];
    abort(); // the loader gives us no handle that did not come by us
}

static struct link link_of(const void *handle)
{
    pthread_mutex_lock(&lock);
    const struct link l = *link_locked(handle);
    pthread_mutex_unlock(&lock);
    return l;
}

static struct link link_take(const void *handle)
{
    pthread_mutex_lock(&lock);
    struct link *at = link_locked(handle), l = *at;
    *at = (struct link){ .key = NULL };
    pthread_mutex_unlock(&lock);
    return l;
}

// Without a file nothing fails, and nothing is counted that anybody reads.
static void control_open(void)
{
    const char *path = getenv(LAYER_LOSS_FILE);
    const int fd = path ? open(path, O_RDWR | O_CLOEXEC) : -1;
    void *map = fd < 0 ? MAP_FAILED : mmap(NULL, sizeof *control, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (path && map == MAP_FAILED)
        abort(); // a test that asks for faults must get them
    if (fd >= 0)
        close(fd);
    control = map == MAP_FAILED ? &nothing : map;
}

// One of so many, if there is one left.
static bool take(_Atomic uint32_t *count)
{
    uint32_t n = atomic_load(count);
    while (n && !atomic_compare_exchange_weak(count, &n, n - 1))
        ;
    return n != 0;
}

// ---- the calls that may fail -------------------------------------------------------------------------

static bool spared(const struct link *l) { return l->submissions <= atomic_load(&control->spare); }

static void stand_still(_Atomic uint32_t *hold)
{
    atomic_fetch_add(&control->held, 1);
    while (atomic_load(hold))
        nanosleep(&(struct timespec){ .tv_nsec = 1000000 }, NULL);
    atomic_fetch_sub(&control->held, 1);
}

static VKAPI_ATTR VkResult VKAPI_CALL submit(VkQueue queue, uint32_t n, const VkSubmitInfo2 *what, VkFence fence)
{
    pthread_mutex_lock(&lock);
    struct link *at = link_locked(queue);
    at->submissions++;
    const struct link l = *at;
    pthread_mutex_unlock(&lock);
    atomic_fetch_add(&control->submitted, 1);
    if (!spared(&l)) {
        stand_still(&control->hold);
        if (take(&control->submit_lost))
            return VK_ERROR_DEVICE_LOST;
    }
    return l.submit(queue, n, what, fence);
}

static VKAPI_ATTR VkResult VKAPI_CALL wait(VkDevice device, const VkSemaphoreWaitInfo *what, uint64_t timeout_ns)
{
    const struct link l = link_of(device);
    if (!spared(&l) && take(&control->wait_lost))
        return VK_ERROR_DEVICE_LOST;
    if (!spared(&l) && take(&control->wait_hung))
        return VK_TIMEOUT;
    return l.wait(device, what, timeout_ns);
}

static VKAPI_ATTR VkResult VKAPI_CALL wait_idle(VkDevice device)
{
    stand_still(&control->hold_idle);
    return link_of(device).wait_idle(device);
}

// ---- the chain -----------------------------------------------------------------------------------------

// The loader's note to us among the caller's structures; it may be moved on, and is not const for that.
static void *note_of(const void *chain, VkStructureType type)
{
    for (const VkBaseInStructure *at = chain; at; at = at->pNext) {
        VkLayerFunction function;
        memcpy(&function, at + 1, sizeof function);
        if (at->sType == type && function == VK_LAYER_LINK_INFO)
            return (void *)(uintptr_t)at;
    }
    return NULL;
}
_Static_assert(offsetof(VkLayerInstanceCreateInfo, function) == sizeof(VkBaseInStructure), "what note_of reads");
_Static_assert(offsetof(VkLayerDeviceCreateInfo, function) == sizeof(VkBaseInStructure), "what note_of reads");

static VKAPI_ATTR VkResult VKAPI_CALL create_instance(const VkInstanceCreateInfo *info, const VkAllocationCallbacks *a, VkInstance *out)
{
    static pthread_once_t once = PTHREAD_ONCE_INIT;
    VkLayerInstanceCreateInfo *note = note_of(info->pNext, VK_STRUCTURE_TYPE_LOADER_INSTANCE_CREATE_INFO);
    pthread_once(&once, control_open);
    if (!note)
        return VK_ERROR_INITIALIZATION_FAILED;
    struct link l = { .instance_next = note->u.pLayerInfo->pfnNextGetInstanceProcAddr };
    note->u.pLayerInfo = note->u.pLayerInfo->pNext;
    const PFN_vkCreateInstance next = (PFN_vkCreateInstance)l.instance_next(NULL, "vkCreateInstance");
    const VkResult r = next(info, a, out);
    if (r != VK_SUCCESS)
        return r;
    l.key = key_of(*out);
    l.instance = *out;
    if (link_add(&l))
        return VK_SUCCESS;
    ((PFN_vkDestroyInstance)l.instance_next(*out, "vkDestroyInstance"))(*out, a);
    return VK_ERROR_TOO_MANY_OBJECTS;
}

static VKAPI_ATTR void VKAPI_CALL destroy_instance(VkInstance instance, const VkAllocationCallbacks *a)
{
    if (!instance)
        return;
    const struct link l = link_take(instance);
    ((PFN_vkDestroyInstance)l.instance_next(instance, "vkDestroyInstance"))(instance, a);
}

static VKAPI_ATTR VkResult VKAPI_CALL create_device(VkPhysicalDevice physical, const VkDeviceCreateInfo *info, const VkAllocationCallbacks *a,
                                                    VkDevice *out)
{
    VkLayerDeviceCreateInfo *note = note_of(info->pNext, VK_STRUCTURE_TYPE_LOADER_DEVICE_CREATE_INFO);
    if (!note || take(&control->create_fails))
        return VK_ERROR_INITIALIZATION_FAILED;
    const PFN_vkGetInstanceProcAddr instance_next = note->u.pLayerInfo->pfnNextGetInstanceProcAddr;
    struct link l = { .device_next = note->u.pLayerInfo->pfnNextGetDeviceProcAddr };
    note->u.pLayerInfo = note->u.pLayerInfo->pNext;
    const PFN_vkCreateDevice next = (PFN_vkCreateDevice)instance_next(link_of(physical).instance, "vkCreateDevice");
    const VkResult r = next(physical, info, a, out);
    if (r != VK_SUCCESS)
        return r;
    l.key = key_of(*out);
    l.submit = (PFN_vkQueueSubmit2)l.device_next(*out, "vkQueueSubmit2");
    l.wait = (PFN_vkWaitSemaphores)l.device_next(*out, "vkWaitSemaphores");
    l.wait_idle = (PFN_vkDeviceWaitIdle)l.device_next(*out, "vkDeviceWaitIdle");
    if (l.submit && l.wait && l.wait_idle && link_add(&l)) {
        atomic_fetch_add(&control->devices, 1);
        return VK_SUCCESS;
    }
    ((PFN_vkDestroyDevice)l.device_next(*out, "vkDestroyDevice"))(*out, a);
    return VK_ERROR_TOO_MANY_OBJECTS;
}

static VKAPI_ATTR void VKAPI_CALL destroy_device(VkDevice device, const VkAllocationCallbacks *a)
{
    if (!device)
        return;
    const struct link l = link_take(device);
    atomic_fetch_add(&control->destroyed, 1);
    ((PFN_vkDestroyDevice)l.device_next(device, "vkDestroyDevice"))(device, a);
}

// ---- what the loader asks for ----------------------------------------------------------------------------

static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL device_function(VkDevice device, const char *name);
static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL instance_function(VkInstance instance, const char *name);

static PFN_vkVoidFunction own(const char *name, bool of_device)
{
    static const struct { const char *name; PFN_vkVoidFunction function; bool of_device; } table[] = {
        { "vkGetInstanceProcAddr", (PFN_vkVoidFunction)instance_function, false },
        { "vkCreateInstance", (PFN_vkVoidFunction)create_instance, false },
        { "vkDestroyInstance", (PFN_vkVoidFunction)destroy_instance, false },
        { "vkCreateDevice", (PFN_vkVoidFunction)create_device, false },
        { "vkGetDeviceProcAddr", (PFN_vkVoidFunction)device_function, true },
        { "vkDestroyDevice", (PFN_vkVoidFunction)destroy_device, true },
        { "vkQueueSubmit2", (PFN_vkVoidFunction)submit, true },
        { "vkWaitSemaphores", (PFN_vkVoidFunction)wait, true },
        { "vkDeviceWaitIdle", (PFN_vkVoidFunction)wait_idle, true },
    };
    for (size_t i = 0; i < sizeof table / sizeof table[0]; i++)
        if (!strcmp(name, table[i].name) && (table[i].of_device || !of_device))
            return table[i].function;
    return NULL;
}

static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL device_function(VkDevice device, const char *name)
{
    PFN_vkVoidFunction function = own(name, true);
    return function ? function : link_of(device).device_next(device, name);
}

static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL instance_function(VkInstance instance, const char *name)
{
    PFN_vkVoidFunction function = own(name, false);
    if (function || !instance)
        return function;
    return link_of(instance).instance_next(instance, name);
}

EXPORT VKAPI_ATTR VkResult VKAPI_CALL vkNegotiateLoaderLayerInterfaceVersion(VkNegotiateLayerInterface *version)
{
    if (version->loaderLayerInterfaceVersion < 2)
        return VK_ERROR_INITIALIZATION_FAILED;
    version->loaderLayerInterfaceVersion = 2;
    version->pfnGetInstanceProcAddr = instance_function;
    version->pfnGetDeviceProcAddr = device_function;
    version->pfnGetPhysicalDeviceProcAddr = NULL;
    return VK_SUCCESS;
}
