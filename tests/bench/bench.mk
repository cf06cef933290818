# SPDX-License-Identifier: Apache-2.0
# bench.mk - `make bench`: speed, error and memory on this machine, as a table and as $(BUILD)/bench/bench.csv.
# `make bench BENCH=--quick` takes about a minute. Installs nothing: `make deps` does.

BENCH ?=
BENCH_SOURCES := $(addprefix tests/bench/,airy_bench.c c_chain.c codec.c jobs.c measure.c run_daemon.c run_engine.c \
	run_error.c scene.c team.c)
BENCH_LIBS = -Wl,--start-group $(filter-out $(BUILD)/server.a,$(ARCHIVES)) -Wl,--end-group \
	$(LIBS_ENGINE) $(LIBS_EXR) $(LIBS_PROTO) -lm

$(BUILD)/tests/bench/%.o: CPPFLAGS += -Itests/reference
# The yardstick gets what the compiler has for this very CPU, as the device's driver does.
$(BUILD)/tests/bench/c_chain.o: CFLAGS += -O3 -march=native -fno-trapping-math -ffp-contract=fast
$(BUILD)/tests/bench/scene.o $(BUILD)/tests/bench/run_error.o: CFLAGS += -O3

$(BUILD)/bench/airy_bench: $(call obj,$(BENCH_SOURCES) tests/reference/reference.c) $(ARCHIVES)
	@mkdir -p $(@D)
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $(filter %.o,$^) -o $@ $(BENCH_LIBS)

# The codec alone, on any file: bench_exr FILE [threads] [repeats].
$(BUILD)/bench/bench_exr: $(call obj,tests/bench/bench_exr.c) $(BUILD)/exr.a $(BUILD)/proto.a
	@mkdir -p $(@D)
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $^ -o $@ $(LIBS_EXR) $(LIBS_PROTO) -lm

# A wall's picture, pass by pass.
$(BUILD)/bench/bench_wall: $(call obj,tests/bench/bench_wall.c $(filter-out tests/bench/airy_bench.c tests/bench/run_%,$(BENCH_SOURCES)) \
	tests/reference/reference.c) $(ARCHIVES)
	@mkdir -p $(@D)
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $(filter %.o,$^) -o $@ $(BENCH_LIBS)

# The daemon as a service: load, connections, kills, memory. FRAMES= small frames; SERVICE= more of its options, parts of it.
FRAMES ?= 100000
SERVICE ?=
$(BUILD)/bench/bench_service: $(call obj,$(wildcard tests/bench/bench_service*.c) $(filter-out tests/bench/airy_bench.c tests/bench/run_%,$(BENCH_SOURCES)) \
	tests/reference/reference.c) $(ARCHIVES)
	@mkdir -p $(@D)
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $(filter %.o,$^) -o $@ $(BENCH_LIBS)

# Ten emulated boards, SECONDS= each (default 60).
SECONDS ?= 60
$(BUILD)/bench/bench_wall_usb: $(call obj,tests/bench/bench_wall_usb.c tests/usb_kit.c tests/usb_kit_model.c) $(BUILD)/libairy.a
	@mkdir -p $(@D)
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $^ -o $@ $(LIBS_PROTO) -llz4 $(shell pkg-config --libs umockdev-1.0 2>/dev/null)
$(BUILD)/tests/bench/bench_wall_usb.o: CPPFLAGS += -Itests

.PHONY: bench bench-wall bench-usb bench-service
bench-service: all $(BUILD)/bench/bench_service
	@$(BUILD)/bench/bench_service --airyd $(BUILD)/airyd --airy $(BUILD)/airy --frames $(FRAMES) $(SERVICE)
bench-usb: $(BUILD)/airyd $(BUILD)/bench/bench_wall_usb
	@umockdev-wrapper $(BUILD)/bench/bench_wall_usb $(BUILD)/airyd $(SECONDS)
bench-wall: $(BUILD)/bench/bench_wall
	@$(BUILD)/bench/bench_wall
bench: all $(BUILD)/bench/airy_bench $(BUILD)/bench/bench_exr
	@$(BUILD)/bench/airy_bench --airyd $(BUILD)/airyd --csv $(BUILD)/bench/bench.csv $(BENCH)
