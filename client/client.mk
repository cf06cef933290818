# SPDX-License-Identifier: Apache-2.0
# client.mk - the airy command, and the demo with its two tools.

include client/python/python.mk

CMD := client/main.c $(wildcard client/cmd_*.c) client/frames.c client/progress.c

$(BUILD)/airy: $(call obj,$(CMD)) $(BUILD)/client.a $(BUILD)/walldef.a $(BUILD)/proto.a
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $^ -o $@ $(LIBS_PROTO) $(LIBS_WALLDEF)

$(BUILD)/demo/scene: $(call obj,$(addprefix client/demo/,scene.c street.c signs.c picture.c))
	@mkdir -p $(@D)
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $^ -o $@ -lOpenEXRCore-3_1 -lm

$(BUILD)/demo/tonemap: $(call obj,$(addprefix client/demo/,tonemap.c picture.c png.c))
	@mkdir -p $(@D)
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $^ -o $@ -lOpenEXRCore-3_1 -lpng -lm

# The pixel loops of the demo's own tools.
$(BUILD)/client/demo/%.o: CFLAGS += -O3 -ffast-math

# A make of its own, so that what deps has just installed is found.
demo: deps
	@$(MAKE) --no-print-directory all $(BUILD)/demo/scene $(BUILD)/demo/tonemap
	@BUILD=$(BUILD) sh client/demo.sh

# tests/test_command.sh makes its pictures with it.
tests: $(BUILD)/demo/scene
