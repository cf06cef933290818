# SPDX-License-Identifier: Apache-2.0
# Fuzz targets (libFuzzer), one a tests/fuzz/fuzz_<name>.c, linked in the variant with ASan and UBSan, build/asan, by
# `make fuzz-built`; seeds are made beside it by the plain build. `make check` runs tests/test_fuzz.sh.

FUZZ_NAMES := $(patsubst tests/fuzz/fuzz_%.c,%,$(wildcard tests/fuzz/fuzz_*.c))
FUZZ_TARGETS := $(FUZZ_NAMES:%=$(T)/fuzz/fuzz_%)

$(T)/fuzz/%.o: CPPFLAGS += -Itests -Itests/tools
$(T)/fuzz/%.o: CFLAGS += $(COVERAGE)
$(T)/fuzz/fuzz_exr: $(T)/tools/exr_run.o
$(T)/fuzz/fuzz_frames: $(BUILD)/client/frames.o

# The parsers of replies are the target: the bus under them answers from the input.
$(T)/fuzz/fuzz_panel: LDFLAGS += -Wl,--wrap=libusb_control_transfer,--wrap=libusb_bulk_transfer
$(T)/fuzz/fuzz_body $(T)/fuzz/fuzz_client: LDFLAGS += -Wl,--wrap=usb_create

$(FUZZ_TARGETS): $(T)/fuzz/%: $(T)/fuzz/%.o $(ARCHIVES)
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) -fsanitize=fuzzer $(filter %.o,$^) -o $@ $(filter-out -lcmocka,$(TEST_LIBS))

$(T)/fuzz/make_seeds: $(T)/fuzz/make_seeds.o $(T)/fuzz/seeds_talk.o $(T)/tools/exr_tool.o $(BUILD)/client.a $(BUILD)/proto.a
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $^ -o $@ $(LIBS_PROTO) $(LIBS_EXR) -lm

.PHONY: fuzz fuzz-built fuzz-targets fuzz-seeds
fuzz-targets: $(FUZZ_TARGETS)
fuzz-seeds: $(T)/fuzz/make_seeds $(BUILD)/airyd
	@rm -rf $(BUILD)/fuzz/seeds && mkdir -p $(BUILD)/fuzz
	@AIRYD=$(BUILD)/airyd $(T)/fuzz/make_seeds $(BUILD)/fuzz/seeds
fuzz-built: fuzz-seeds
	@$(SUB) $(ASAN) fuzz-targets

# Each target for MINUTES (shared among them all, two at a time); what is found is named, and kept in build/fuzz/found.
# FUZZ="exr wall": only these.
fuzz: deps
	@$(MAKE) --no-print-directory fuzz-built
	@BUILD=$(BUILD) MINUTES=$(MINUTES) bash tests/fuzz/fuzz.sh $(or $(FUZZ),$(FUZZ_NAMES))
