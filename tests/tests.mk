# SPDX-License-Identifier: Apache-2.0
# One program a tests/test_<module>.c (cmocka), one script a tests/test_<name>.sh; both print TAP. `make check`
# builds them three times (gcc, clang with ASan+UBSan, gcc with TSan what has threads), runs each where it means something, and ends in the
# one line `N passed, N failed, N skipped`.

T := $(BUILD)/tests
TESTS := $(patsubst tests/%.c,$(T)/%,$(wildcard tests/test_*.c))
TEST_LIBS = -Wl,--start-group $(ARCHIVES) -Wl,--end-group \
	$(LIBS_ENGINE) $(LIBS_EXR) $(LIBS_PROTO) $(LIBS_WALL) $(LIBS_WALLDEF) -lsystemd -lcmocka -lm

$(T)/%.o $(BUILD)/tests/%.o: CPPFLAGS += -Itests -Itests/reference -Itests/tools

# What a test needs besides the archives.
$(T)/test_reference $(T)/test_reference_pipeline: $(T)/reference/reference.o
HARD_TESTS := $(filter $(T)/test_hard%,$(TESTS))
$(T)/test_engine $(HARD_TESTS) $(T)/test_property: $(T)/reference/reference.o $(T)/scene_kit.o $(T)/scene_kernel.o
$(HARD_TESTS): $(T)/hard_kit.o
$(T)/test_wall_engine: $(T)/reference/reference.o $(T)/reference/reference_wall.o $(T)/scene_kit.o $(T)/scene_kernel.o
$(T)/test_look: $(T)/reference/reference_look.o $(T)/look_kit.o
$(T)/test_server $(T)/test_server_frames $(T)/test_server_life $(T)/test_server_walls $(T)/test_libairy_kill: $(T)/daemon_fixture.o $(T)/daemon_picture.o
$(T)/test_server_looks: $(T)/daemon_fixture.o $(T)/daemon_picture.o $(T)/daemon_exr.o $(T)/tools/exr_tool.o $(T)/scene_kit.o \
	$(T)/scene_kernel.o $(T)/reference/reference.o $(T)/reference/reference_look.o
$(T)/test_exr $(T)/test_exr_layers $(T)/test_exr_grow $(T)/test_exr_bad: $(T)/tools/exr_run.o $(T)/tools/exr_tool.o
$(T)/test_wall_colour: $(T)/reference/reference_led.o
$(T)/test_frames: $(BUILD)/client/frames.o $(BUILD)/client/progress.o
# A real disk; only its failures are injected.
$(T)/test_output: $(addprefix $(BUILD)/client/,cmd_output.o cmd_cleanup.o cmd_exr.o)
$(T)/test_output: LDFLAGS += -Wl,--wrap=fallocate,--wrap=sendfile,--wrap=write,--wrap=fsync,--wrap=renameat2
$(T)/test_wall_text: $(addprefix $(BUILD)/client/,cmd_wall_text.o cmd_wall_clock.o cmd_json.o)
$(T)/test_libairy $(T)/test_libairy_request $(T)/test_libairy_bad $(T)/test_libairy_asset $(T)/test_libairy_wall $(T)/test_libairy_retry $(T)/test_wall_command $(T)/test_bloom_command: $(T)/airy_peer.o

# Dense sums over every pair of pixels of a row: the compiler vectorises them.
$(T)/reference/reference.o $(T)/scene_kernel.o: CFLAGS += $(if $(SAN),,-O3)

# The device is the real one; only its loss is injected.
$(T)/test_sched: LDFLAGS += -Wl,--wrap=bloom_run,--wrap=bloom_create

# ... and here by a Vulkan layer, which the loader finds by its manifest. It stays loaded, and its counts with it.
LAYER_LOSS := $(T)/layer_loss.so $(T)/vulkan/implicit_layer.d/layer_loss.json
$(T)/test_server_loss: $(T)/daemon_fixture.o $(T)/daemon_picture.o | $(LAYER_LOSS)
$(T)/layer_loss.so: $(T)/layer_loss.o
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) -shared -Wl,-z,nodelete $< -o $@
$(T)/vulkan/implicit_layer.d/layer_loss.json: tests/layer_loss.json
	@mkdir -p $(@D)
	$(Q)cp $< $@

# The daemon's own allocations can be refused.
$(T)/test_server_memory: LDFLAGS += -Wl,--wrap=malloc,--wrap=calloc,--wrap=realloc,--wrap=mmap
$(T)/test_server_limits $(T)/test_server_memory $(T)/test_server_faults: $(T)/daemon_fixture.o $(T)/daemon_picture.o

# What the engine allocates is counted.
$(T)/test_room: LDFLAGS += -Wl,--wrap=malloc,--wrap=calloc,--wrap=realloc,--wrap=aligned_alloc,--wrap=free,--wrap=vkAllocateMemory,--wrap=vkFreeMemory

# What a wall hands to its boards is recorded in their place.
$(T)/test_wall_boards: LDFLAGS += -Wl,--wrap=usb_board_add,--wrap=usb_board_remove,--wrap=usb_board_send,--wrap=usb_board_idle,--wrap=usb_board_stats

$(T)/test_server_assets $(T)/test_asset: $(T)/daemon_fixture.o $(T)/daemon_picture.o

# Boards without hardware; these programs run under umockdev-wrapper.
USB_KIT := $(T)/usb_kit.o $(T)/usb_kit_model.o
USB_TESTS := $(T)/test_usb $(T)/test_usb_faults $(T)/test_panel $(T)/test_panel_gud $(T)/test_usb_daemon
$(T)/usb_kit.o: CPPFLAGS += $(call pkgcflags,umockdev-1.0)
$(USB_TESTS): $(USB_KIT) $(T)/usb_rig.o
$(T)/test_usb_daemon: $(T)/daemon_fixture.o $(T)/daemon_picture.o
$(USB_TESTS): TEST_LIBS += $(shell pkg-config --libs umockdev-1.0 2>/dev/null)
$(T)/test_usb: | $(T)/usb_probe
$(T)/usb_probe: $(T)/usb_probe.o $(BUILD)/wall.a $(BUILD)/proto.a
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $^ -o $@ $(LIBS_WALL) -lprotobuf-c

# The golden messages, written anew; tests/test_vectors.sh says when the committed ones are others.
VECTORS_TOOL := $(addprefix $(T)/tools/,make_vectors.o make_vectors_stamp.o make_vectors_turns.o make_vectors_wall.o)
$(T)/make_vectors: $(VECTORS_TOOL) $(BUILD)/params.a $(BUILD)/proto.a
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $^ -o $@ $(LIBS_PROTO) -lm
.PHONY: vectors
vectors: $(T)/make_vectors
	@rm -f proto/vectors/*.hex proto/vectors/*.json
	@$(T)/make_vectors proto/vectors

# The same boards on a real kernel, in a machine of its own: slow, optional, no part of check.
$(T)/usb_vhci_guest: $(T)/usb_vhci_guest.o $(T)/usb_vhci.o $(T)/usb_vhci_drive.o $(T)/usb_kit_model.o $(T)/daemon_fixture.o $(ARCHIVES)
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $(filter %.o,$^) -o $@ $(TEST_LIBS)
.PHONY: check-usb
check-usb: $(BUILD)/airyd $(T)/usb_vhci_guest
	@BUILD=$(BUILD) bash tests/usb_vhci.sh

$(TESTS): $(T)/%: $(T)/%.o $(ARCHIVES)
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $(filter %.o,$^) -o $@ $(TEST_LIBS)

.PHONY: tests check-built check
tests: $(TESTS) $(T)/make_vectors

# A make of its own, so that what deps has just installed is found; variants share nothing but the sources.
check: deps
	@$(MAKE) --no-print-directory check-built

SUB = $(MAKE) --no-print-directory -j$(shell nproc) SPIRV_DIR=$(SPIRV_DIR)
ASAN = BUILD=$(BUILD)/asan CC=clang SAN=address,undefined
TSAN = BUILD=$(BUILD)/tsan SAN=thread
check-built:
	@echo "building: $(BUILD), $(BUILD)/asan, $(BUILD)/tsan"
	@$(SUB) all tests
	@$(SUB) $(ASAN) all tests
	@$(SUB) $(TSAN) all $$(bash tests/run.sh --threaded | sed 's|.*|$(BUILD)/tsan/tests/test_&|')
	@$(MAKE) --no-print-directory fuzz-built
	@BUILD=$(BUILD) bash tests/run.sh

# A real workload manager is too heavy for check.
.PHONY: farm-test
farm-test: deps
	@$(MAKE) --no-print-directory deps PKGS_TEST="slurm-wlm munge"
	@$(SUB) all $(BUILD)/demo/scene
	@BUILD=$(BUILD) bash tests/farm_slurm.sh

include tests/soak/soak.mk
include tests/bench/bench.mk
include tests/report/report.mk
include tests/fuzz/fuzz.mk
