# SPDX-License-Identifier: Apache-2.0
SPIRV := $(SPIRV_DIR)/spirv.h $(SPIRV_DIR)/spirv_look.h

$(SPIRV) &: shaders/embed.sh $(wildcard shaders/*.frag shaders/*.vert shaders/*.comp shaders/*.glsl)
	@mkdir -p $(@D)
	@echo "glslang shaders/* -> $(SPIRV)"
	@sh shaders/embed.sh $(SPIRV_DIR)
