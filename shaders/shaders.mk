# SPDX-License-Identifier: Apache-2.0
SPIRV := $(BUILD)/gen/spirv.h

$(SPIRV): shaders/embed.sh $(wildcard shaders/*.frag shaders/*.vert shaders/*.comp shaders/*.glsl)
	@mkdir -p $(@D)
	@echo "glslang shaders/* -> $@"
	@sh shaders/embed.sh $(BUILD)/gen
