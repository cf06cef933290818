// SPDX-License-Identifier: Apache-2.0
// vk.c - opening and closing a device: choice, features, the one pipeline layout, validation.
#include "vk.h"

#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>


enum { DEVICES_MAX = 16 };

int vk_fault(struct fault *f, VkResult r, const char *what)
{
    switch (r) {
    case VK_ERROR_DEVICE_LOST:
        return fault_set(f, FAULT_DEVICE_LOST, "", "%s: the Vulkan device was lost", what);
    case VK_ERROR_OUT_OF_HOST_MEMORY:
    case VK_ERROR_OUT_OF_DEVICE_MEMORY:
        return fault_set(f, FAULT_NO_MEMORY, "", "%s: out of Vulkan memory", what);
    default:
        return fault_set(f, FAULT_INTERNAL, "", "%s: VkResult %d", what, (int)r);
    }
}

static VkBool32 on_message(VkDebugUtilsMessageSeverityFlagBitsEXT severity,
                           VkDebugUtilsMessageTypeFlagsEXT type,
                           const VkDebugUtilsMessengerCallbackDataEXT *data, void *user)
{
    (void)severity;
    (void)type;
    struct vk *v = user;
    v->messages++;
    if (v->log) {
        char line[2048];
        snprintf(line, sizeof(line), "validation: %s", data->pMessage);
        v->log(line);
    }
    return VK_FALSE;
}

static int create_instance(struct vk *v, bool validate, struct fault *f)
{
    const VkApplicationInfo app = {
        .sType = VK_STRUCTURE_TYPE_APPLICATION_INFO,
        .pApplicationName = "airyd",
        .apiVersion = VK_API_VERSION_1_3,
    };
    const char *layers[] = { "VK_LAYER_KHRONOS_validation" };
    const char *extensions[] = { VK_EXT_DEBUG_UTILS_EXTENSION_NAME };
    const VkValidationFeatureEnableEXT enables[] = {
        VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT,
    };
    const VkValidationFeaturesEXT features = {
        .sType = VK_STRUCTURE_TYPE_VALIDATION_FEATURES_EXT,
        .enabledValidationFeatureCount = 1,
        .pEnabledValidationFeatures = enables,
    };
    const VkDebugUtilsMessengerCreateInfoEXT messenger = {
        .sType = VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT,
        .pNext = &features,
        .messageSeverity = VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT |
                           VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT,
        .messageType = VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT |
                       VK_DEBUG_UTILS_MESSAGE_TYPE_GENERAL_BIT_EXT,
        .pfnUserCallback = on_message,
        .pUserData = v,
    };
    const VkInstanceCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO,
        .pNext = validate ? &messenger : NULL,
        .pApplicationInfo = &app,
        .enabledLayerCount = validate ? 1 : 0,
        .ppEnabledLayerNames = layers,
        .enabledExtensionCount = validate ? 1 : 0,
        .ppEnabledExtensionNames = extensions,
    };
    VkResult r = vkCreateInstance(&info, NULL, &v->instance);
    if (r == VK_ERROR_LAYER_NOT_PRESENT)
        return fault_set(f, FAULT_INTERNAL, "validate",
                         "the Vulkan validation layers are not installed (vulkan-validationlayers)");
    if (r != VK_SUCCESS)
        return fault_set(f, FAULT_INTERNAL, "device",
                         "no Vulkan here (vkCreateInstance: VkResult %d); mesa-vulkan-drivers has a "
                         "device for every machine",
                         (int)r);
    if (!validate)
        return 0;
    PFN_vkCreateDebugUtilsMessengerEXT create =
        (PFN_vkCreateDebugUtilsMessengerEXT)vkGetInstanceProcAddr(v->instance,
                                                                  "vkCreateDebugUtilsMessengerEXT");
    VkDebugUtilsMessengerCreateInfoEXT plain = messenger;
    plain.pNext = NULL;
    r = create ? create(v->instance, &plain, NULL, &v->messenger) : VK_ERROR_EXTENSION_NOT_PRESENT;
    return r == VK_SUCCESS ? 0 : vk_fault(f, r, "vkCreateDebugUtilsMessengerEXT");
}

static const char *kind_of(VkPhysicalDeviceType t)
{
    return t == VK_PHYSICAL_DEVICE_TYPE_CPU ? "cpu" : "gpu";
}

static unsigned enumerate(VkInstance instance, VkPhysicalDevice out[DEVICES_MAX])
{
    uint32_t n = DEVICES_MAX;
    VkResult r = vkEnumeratePhysicalDevices(instance, &n, out);
    return r == VK_SUCCESS || r == VK_INCOMPLETE ? n : 0;
}

void vk_list(void (*print)(const char *line))
{
    struct vk v = { 0 };
    VkPhysicalDevice devices[DEVICES_MAX];
    if (create_instance(&v, false, NULL) < 0)
        return;
    unsigned n = enumerate(v.instance, devices);
    for (unsigned i = 0; i < n; i++) {
        VkPhysicalDeviceProperties p;
        char line[VK_MAX_PHYSICAL_DEVICE_NAME_SIZE + 32];
        vkGetPhysicalDeviceProperties(devices[i], &p);
        snprintf(line, sizeof(line), "%u: %s (%s)", i, p.deviceName, kind_of(p.deviceType));
        print(line);
    }
    vk_close(&v);
}

static bool matches(const char *want, unsigned index, const VkPhysicalDeviceProperties *p)
{
    if (!strcmp(want, "cpu") || !strcmp(want, "gpu"))
        return !strcmp(want, kind_of(p->deviceType));
    char *end;
    unsigned long n = strtoul(want, &end, 10);
    if (isdigit((unsigned char)*want) && !*end)
        return n == index;
    return strcasestr(p->deviceName, want) != NULL;
}

// A discrete GPU before an integrated one before anything else before the CPU.
static int rank(VkPhysicalDeviceType t)
{
    switch (t) {
    case VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU: return 3;
    case VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU: return 2;
    case VK_PHYSICAL_DEVICE_TYPE_CPU: return 0;
    default: return 1;
    }
}

static int choose_physical(struct vk *v, const char *want, struct fault *f)
{
    VkPhysicalDevice devices[DEVICES_MAX];
    unsigned n = enumerate(v->instance, devices);
    int best = -1;
    for (unsigned i = 0; i < n; i++) {
        VkPhysicalDeviceProperties p;
        vkGetPhysicalDeviceProperties(devices[i], &p);
        if (p.apiVersion < VK_API_VERSION_1_3)
            continue;
        if (want && *want && !matches(want, i, &p))
            continue;
        if (rank(p.deviceType) > best) {
            best = rank(p.deviceType);
            v->physical = devices[i];
            v->properties = p;
        }
    }
    if (best < 0)
        return fault_set(f, FAULT_INTERNAL, "device",
                         "no Vulkan 1.3 device for --device '%s' among %u (--list-devices shows them)",
                         want ? want : "", n);
    v->cpu = v->properties.deviceType == VK_PHYSICAL_DEVICE_TYPE_CPU;
    VkPhysicalDeviceMaintenance3Properties limits = { .sType =
                                                          VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MAINTENANCE_3_PROPERTIES };
    VkPhysicalDeviceDriverProperties driver = { .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DRIVER_PROPERTIES,
                                                .pNext = &limits };
    VkPhysicalDeviceProperties2 p2 = { .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2,
                                       .pNext = &driver };
    vkGetPhysicalDeviceProperties2(v->physical, &p2);
    v->block_max = limits.maxMemoryAllocationSize;
    snprintf(v->driver, sizeof(v->driver), "%.100s %.100s", driver.driverName, driver.driverInfo);
    vkGetPhysicalDeviceMemoryProperties(v->physical, &v->memory);
    return 0;
}

static int choose_family(struct vk *v, struct fault *f)
{
    VkQueueFamilyProperties families[16];
    uint32_t n = 16;
    vkGetPhysicalDeviceQueueFamilyProperties(v->physical, &n, families);
    for (uint32_t i = 0; i < n; i++)
        if (families[i].queueFlags & VK_QUEUE_GRAPHICS_BIT) {
            v->family = i;
            return 0;
        }
    return fault_set(f, FAULT_INTERNAL, "device", "%s has no graphics queue", v->properties.deviceName);
}

static int create_device(struct vk *v, struct fault *f)
{
    VkPhysicalDeviceVulkan13Features f13 = {
        .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES,
        .synchronization2 = VK_TRUE,
        .dynamicRendering = VK_TRUE,
        .maintenance4 = VK_TRUE, // a compute shader's size as SPIR-V 1.6 says it
    };
    VkPhysicalDeviceVulkan12Features f12 = {
        .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES,
        .pNext = &f13,
        .timelineSemaphore = VK_TRUE,
    };
    const float priority = 1.0f;
    const VkDeviceQueueCreateInfo queue = {
        .sType = VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO,
        .queueFamilyIndex = v->family,
        .queueCount = 1,
        .pQueuePriorities = &priority,
    };
    const char *extensions[] = { VK_KHR_PUSH_DESCRIPTOR_EXTENSION_NAME };
    const VkDeviceCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO,
        .pNext = &f12,
        .queueCreateInfoCount = 1,
        .pQueueCreateInfos = &queue,
        .enabledExtensionCount = 1,
        .ppEnabledExtensionNames = extensions,
    };
    VkResult r = vkCreateDevice(v->physical, &info, NULL, &v->device);
    if (r != VK_SUCCESS)
        return vk_fault(f, r, "vkCreateDevice");
    vkGetDeviceQueue(v->device, v->family, 0, &v->queue);
    v->push_descriptor_set =
        (PFN_vkCmdPushDescriptorSetKHR)vkGetDeviceProcAddr(v->device, "vkCmdPushDescriptorSetKHR");

    const VkCommandPoolCreateInfo pool = {
        .sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO,
        .flags = VK_COMMAND_POOL_CREATE_RESET_COMMAND_BUFFER_BIT,
        .queueFamilyIndex = v->family,
    };
    r = vkCreateCommandPool(v->device, &pool, NULL, &v->pool);
    if (r != VK_SUCCESS)
        return vk_fault(f, r, "vkCreateCommandPool");
    const VkSemaphoreTypeCreateInfo type = {
        .sType = VK_STRUCTURE_TYPE_SEMAPHORE_TYPE_CREATE_INFO,
        .semaphoreType = VK_SEMAPHORE_TYPE_TIMELINE,
    };
    const VkSemaphoreCreateInfo semaphore = { .sType = VK_STRUCTURE_TYPE_SEMAPHORE_CREATE_INFO,
                                              .pNext = &type };
    r = vkCreateSemaphore(v->device, &semaphore, NULL, &v->timeline);
    return r == VK_SUCCESS ? 0 : vk_fault(f, r, "vkCreateSemaphore");
}

static int create_layouts(struct vk *v, const uint32_t *vertex, size_t vertex_bytes, struct fault *f)
{
    const VkShaderStageFlags stage = VK_SHADER_STAGE_FRAGMENT_BIT | VK_SHADER_STAGE_COMPUTE_BIT;
    const VkDescriptorSetLayoutBinding bindings[] = {
        { .binding = 0, .descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_IMAGE, .descriptorCount = 1, .stageFlags = stage },
        { .binding = 1, .descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_IMAGE, .descriptorCount = 1, .stageFlags = stage },
        { .binding = 2, .descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_IMAGE, .descriptorCount = VK_PLANES, .stageFlags = stage },
        { .binding = 3, .descriptorType = VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER, .descriptorCount = 1, .stageFlags = stage },
        { .binding = 4, .descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_IMAGE, .descriptorCount = 1, .stageFlags = stage },
        { .binding = 5, .descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_IMAGE, .descriptorCount = 1, .stageFlags = stage },
        { .binding = 6, .descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, .descriptorCount = 1, .stageFlags = stage },
    };
    const VkDescriptorSetLayoutCreateInfo set = {
        .sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO,
        .flags = VK_DESCRIPTOR_SET_LAYOUT_CREATE_PUSH_DESCRIPTOR_BIT_KHR,
        .bindingCount = sizeof(bindings) / sizeof(bindings[0]),
        .pBindings = bindings,
    };
    VkResult r = vkCreateDescriptorSetLayout(v->device, &set, NULL, &v->set_layout);
    if (r != VK_SUCCESS)
        return vk_fault(f, r, "vkCreateDescriptorSetLayout");
    const VkPipelineLayoutCreateInfo layout = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO,
        .setLayoutCount = 1,
        .pSetLayouts = &v->set_layout,
    };
    r = vkCreatePipelineLayout(v->device, &layout, NULL, &v->pipeline_layout);
    if (r != VK_SUCCESS)
        return vk_fault(f, r, "vkCreatePipelineLayout");
    const VkShaderModuleCreateInfo module = {
        .sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO,
        .codeSize = vertex_bytes,
        .pCode = vertex,
    };
    r = vkCreateShaderModule(v->device, &module, NULL, &v->vertex);
    return r == VK_SUCCESS ? 0 : vk_fault(f, r, "vkCreateShaderModule");
}

int vk_open(struct vk *v, const char *device, bool validate, void (*log)(const char *),
            const uint32_t *vertex, size_t vertex_bytes, struct fault *f)
{
    *v = (struct vk){ .log = log };
    if (create_instance(v, validate, f) < 0 || choose_physical(v, device, f) < 0 ||
        choose_family(v, f) < 0 || create_device(v, f) < 0 || create_layouts(v, vertex, vertex_bytes, f) < 0) {
        vk_close(v);
        return -1;
    }
    return 0;
}

void vk_close(struct vk *v)
{
    if (v->device) {
        vkDeviceWaitIdle(v->device);
        vkDestroyShaderModule(v->device, v->vertex, NULL);
        vkDestroyPipelineLayout(v->device, v->pipeline_layout, NULL);
        vkDestroyDescriptorSetLayout(v->device, v->set_layout, NULL);
        vkDestroySemaphore(v->device, v->timeline, NULL);
        vkDestroyCommandPool(v->device, v->pool, NULL);
        vkDestroyDevice(v->device, NULL);
    }
    if (v->messenger) {
        PFN_vkDestroyDebugUtilsMessengerEXT destroy =
            (PFN_vkDestroyDebugUtilsMessengerEXT)vkGetInstanceProcAddr(
                v->instance, "vkDestroyDebugUtilsMessengerEXT");
        if (destroy)
            destroy(v->instance, v->messenger, NULL);
    }
    if (v->instance)
        vkDestroyInstance(v->instance, NULL);
    unsigned messages = v->messages;
    *v = (struct vk){ .messages = messages };
}
