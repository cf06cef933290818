# SPDX-License-Identifier: Apache-2.0
SPIRV := $(BUILD)/gen/spirv.h $(BUILD)/gen/spirv_look.h

$(SPIRV) &: shaders/embed.sh $(wildcard shaders/*.frag shaders/*.vert shaders/*.comp shaders/*.glsl)
	@mkdir -p $(@D)
	@echo "glslang shaders/* -> $(SPIRV)"
	@sh shaders/embed.sh $(BUILD)/gen
