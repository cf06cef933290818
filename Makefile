# SPDX-License-Identifier: Apache-2.0
# Everything is built under $(BUILD). `make help` lists the targets.
#
# Variants: make SAN=address,undefined (or thread) BUILD=build/asan; make CC=clang BUILD=build/clang.

BUILD ?= build
SAN ?=
# The shaders' words: the same for all variants.
SPIRV_DIR ?= $(BUILD)/gen
CC ?= gcc
ifeq ($(origin CC),default)
CC := gcc
endif
CXX := $(if $(findstring clang,$(CC)),clang++,g++)

# What a bare Debian 12 needs; installed by `make deps` (part of demo and check) when missing.
# liblz4: GUD displays take their rows compressed.
PKGS_BUILD := gcc g++ pkg-config glslang-tools protobuf-c-compiler protobuf-compiler \
	libvulkan-dev libopenexr-dev libdeflate-dev libprotobuf-c-dev libsystemd-dev libpng-dev libxxhash-dev \
	libyaml-dev libusb-1.0-0-dev liblz4-dev
PKGS_RUN := mesa-vulkan-drivers
# umockdev: USB boards without hardware, for the unmodified daemon.
# systemd: what checks the units; dpkg-dev: make deb. Neither has to run this machine.
PKGS_TEST := libcmocka-dev vulkan-validationlayers clang libclang-rt-14-dev umockdev libumockdev-dev systemd dpkg-dev

WARN := -Wall -Wextra -Werror -Wshadow -Wstrict-prototypes -Wmissing-prototypes -Wvla -Wformat=2
# Sanitized code is not fast anyway: build it quickly. gcc sees null pointers in what UBSan adds to sprintf.
OPT := $(if $(SAN),-O1 -g1,-O2 -g)
CPPFLAGS := -D_GNU_SOURCE -DAIRY_BUILD -Iproto -Idaemon -Idaemon/wall -Iclient -I$(BUILD)/gen -I$(SPIRV_DIR)
SANFLAGS := $(if $(SAN),-fsanitize=$(SAN) -fno-sanitize-recover=undefined -fno-omit-frame-pointer $(if $(findstring clang,$(CC)),,-Wno-format-overflow))
CFLAGS += -std=c11 $(OPT) $(WARN) -fPIC -fvisibility=hidden -pthread -ffp-contract=off $(SANFLAGS)
CXXFLAGS += -std=c++17 $(OPT) -Wall -Wextra -Werror -fPIC -fvisibility=hidden -pthread $(SANFLAGS) \
	$(if $(SAN),-fno-sanitize=vptr)
LDFLAGS += -pthread $(SANFLAGS)
# The fuzz targets are linked from what the tests with ASan are.
COVERAGE := $(if $(findstring clang,$(CC)),$(if $(findstring address,$(SAN)),-fsanitize=fuzzer-no-link))
$(BUILD)/daemon/%.o $(BUILD)/proto/%.o $(BUILD)/client/%.o: CFLAGS += $(COVERAGE)
$(BUILD)/daemon/%.o: CXXFLAGS += $(COVERAGE)

pkgcflags = $(shell pkg-config --cflags $(1) 2>/dev/null | sed 's/-I/-isystem /g')
CPPFLAGS += $(call pkgcflags,OpenEXR libprotobuf-c libusb-1.0)
LIBS_EXR := -lOpenEXR-3_1 -lOpenEXRCore-3_1 -lIex-3_1 -lIlmThread-3_1 -lImath-3_1 -ldeflate -lstdc++
LIBS_ENGINE := -lvulkan
LIBS_PROTO := -lprotobuf-c
LIBS_WALL := -lusb-1.0 -llz4
LIBS_WALLDEF := -lyaml -lpng -lm

# ---- rooms: one archive each, dependencies one way -------------------------------------------
ROOM_proto := $(wildcard proto/*.c)
ROOM_exr := $(wildcard daemon/exr*.c) daemon/frame.c
ROOM_engine := $(wildcard daemon/vk*.c daemon/bloom*.c daemon/kernel*.c daemon/look*.c) daemon/plan.c daemon/psf.c \
	daemon/convolve.c daemon/fft.c daemon/crew.c daemon/pulse.c
ROOM_params := $(wildcard daemon/params*.c)
ROOM_server := $(filter-out daemon/main.c $(ROOM_exr) $(ROOM_engine) $(ROOM_params),$(wildcard daemon/*.c))
# Of the wall, what is arithmetic on its definition: the airy command uses it, too.
ROOM_walldef := $(wildcard daemon/wall/wall_def*.c daemon/wall/wall_layout*.c daemon/wall/wall_draw*.c)
ROOM_wall := $(filter-out $(ROOM_walldef),$(wildcard daemon/wall/*.c))
ROOM_client := $(wildcard client/lib*.c)

obj = $(patsubst %.c,$(BUILD)/%.o,$(1))
PROTO_GEN := $(BUILD)/gen/airy.pb-c.c
ARCHIVES := $(foreach r,proto exr engine params wall walldef server client,$(BUILD)/$(r).a)

# `make V=1` shows the commands.
Q := $(if $(V),,@)
say = $(if $(V),,@echo "  $(1)")

.DEFAULT_GOAL := help
.PHONY: help all deps install deb clean format
.DELETE_ON_ERROR:
.SECONDARY:

help:
	@echo "make demo     build, start the daemon, bloom an HDR frame through the socket -> build/demo/"
	@echo "make check    build and pass the tests (installs what is missing, about 20 minutes); TEST='*sched': only what is called so"
	@echo "make all      build/airyd (daemon), build/airy (command), build/libairy.so and .a"
	@echo "make bench    speed: medians and ratios on this machine"
	@echo "make bench-wall  a wall's picture, pass by pass;  make bench-usb  ten emulated controllers, SECONDS=60 each"
	@echo "make bench-service  STATUS and small jobs under load, 10,000 connections, kill -9, memory over FRAMES=100000 (about 12 minutes)"
	@echo "make report   speed against error, hard cases, shimmer, pictures -> build/report/index.html (about 5 minutes)"
	@echo "make check-usb  the wall against a real kernel's USB in QEMU (optional; downloads Debian's kernel, minutes)"
	@echo "make soak     a real daemon under mixed clients and faults for MINUTES=30, then ROUNDS=200 of kill -9; SEED= chooses the same again"
	@echo "make soak-scenes  random requests against the float64 reference for MINUTES=30"
	@echo "make fuzz     hostile input at every reader for MINUTES=30 (FUZZ=\"exr wall\": only these)"
	@echo "make vectors  write proto/vectors anew, the golden messages, after a change of airy.proto or tests/tools/make_vectors*.c"
	@echo "make farm-test  the Slurm script under a real Slurm of one node: installs slurm-wlm and munge (not part of check), needs root"
	@echo "make install  to PREFIX (default /usr/local), DESTDIR honoured"
	@echo "make deb      a Debian package of it -> build/airyd_VERSION_ARCH.deb"
	@echo "make deps     install the Debian packages that are missing (root or sudo)"
	@echo "make clean    remove build/"

# Installs nothing, and asks for nothing, when all is there.
deps:
	@missing=; for p in $(PKGS_BUILD) $(PKGS_RUN) $(PKGS_TEST); do \
	  dpkg-query -W -f='$${Status}' $$p 2>/dev/null | grep -q 'ok installed' || missing="$$missing $$p"; done; \
	if [ -n "$$missing" ]; then \
	  echo "airyd: installing Debian packages:$$missing"; \
	  sudo=; [ "$$(id -u)" = 0 ] || sudo=sudo; \
	  [ -z "$$sudo" ] || command -v sudo >/dev/null || { echo "airyd: run as root, or install sudo"; exit 1; }; \
	  $$sudo apt-get update -qq && \
	  $$sudo env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $$missing >/dev/null; fi

all: $(BUILD)/airyd $(BUILD)/airy $(BUILD)/libairy.so $(BUILD)/libairy.a $(BUILD)/airy.h

# ---- generated: protobuf bodies, SPIR-V ---------------------------------------------------------
$(BUILD)/gen/airy.pb-c.c $(BUILD)/gen/airy.pb-c.h &: proto/airy.proto
	@mkdir -p $(BUILD)/gen
	$(call say,PROTOC $<)
	$(Q)protoc-c --proto_path=proto --c_out=$(BUILD)/gen proto/airy.proto

include shaders/shaders.mk

# ---- compile --------------------------------------------------------------------------------------
$(BUILD)/%.o: %.c | $(BUILD)/gen/airy.pb-c.h $(SPIRV)
	@mkdir -p $(@D)
	$(call say,CC $@)
	$(Q)$(CC) $(CPPFLAGS) $(CFLAGS) -MMD -MP -c $< -o $@

$(BUILD)/%.o: %.cc
	@mkdir -p $(@D)
	$(call say,CXX $@)
	$(Q)$(CXX) $(CPPFLAGS) $(CXXFLAGS) -MMD -MP -c $< -o $@

$(BUILD)/gen/airy.pb-c.o: $(BUILD)/gen/airy.pb-c.c
	$(call say,CC $@)
	$(Q)$(CC) $(CPPFLAGS) -std=c11 $(OPT) -fPIC -fvisibility=hidden $(SANFLAGS) -c $< -o $@

# Pixel loops that the compiler vectorises.
$(BUILD)/daemon/frame.o $(BUILD)/daemon/exr_zip.o $(BUILD)/daemon/exr_encode.o $(BUILD)/daemon/fft.o \
$(BUILD)/daemon/kernel_aperture.o $(BUILD)/daemon/convolve.o $(BUILD)/daemon/bloom_host_rows.o: CFLAGS += $(if $(SAN),,-O3)

# Selects may be taken on both sides: no code here looks at the FPU's flags.
$(BUILD)/daemon/kernel_aperture.o $(BUILD)/daemon/bloom_host_rows.o: CFLAGS += -fno-trapping-math -fno-math-errno

$(BUILD)/proto.a: $(call obj,$(ROOM_proto)) $(BUILD)/gen/airy.pb-c.o
$(BUILD)/exr.a: $(call obj,$(ROOM_exr)) $(patsubst %.cc,$(BUILD)/%.o,$(wildcard daemon/exr*.cc))
$(BUILD)/engine.a: $(call obj,$(ROOM_engine))
$(BUILD)/params.a: $(call obj,$(ROOM_params))
$(BUILD)/walldef.a: $(call obj,$(ROOM_walldef))
$(BUILD)/wall.a: $(call obj,$(ROOM_wall))
$(BUILD)/server.a: $(call obj,$(ROOM_server))
$(BUILD)/client.a: $(call obj,$(ROOM_client))
$(ARCHIVES):
	@rm -f $@
	$(Q)ar rcs $@ $^

DAEMON_LIBS := $(BUILD)/server.a $(BUILD)/wall.a $(BUILD)/walldef.a $(BUILD)/engine.a $(BUILD)/exr.a $(BUILD)/params.a $(BUILD)/proto.a
$(BUILD)/airyd: $(BUILD)/daemon/main.o $(DAEMON_LIBS)
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $^ -o $@ $(LIBS_ENGINE) $(LIBS_EXR) $(LIBS_PROTO) $(LIBS_WALL) $(LIBS_WALLDEF) -lsystemd

$(BUILD)/libairy.a: $(call obj,$(ROOM_client) $(ROOM_proto)) $(BUILD)/gen/airy.pb-c.o
	@rm -f $@
	$(Q)ar rcs $@ $^
$(BUILD)/libairy.so: $(call obj,$(ROOM_client) $(ROOM_proto)) $(BUILD)/gen/airy.pb-c.o
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) -shared -Wl,-soname,libairy.so.0 $^ -o $@ $(LIBS_PROTO)
$(BUILD)/airy.h: client/airy.h
	@mkdir -p $(@D)
	$(Q)cp $< $@

# A folder of a staged install may be called *.d, too.
-include $(shell find $(BUILD) -name '*.d' -type f 2>/dev/null)

include client/client.mk tests/tests.mk

# ---- install, package ---------------------------------------------------------------------------------
include systemd/install.mk

clean:
	rm -rf $(BUILD)
format:
	clang-format -i $(shell git ls-files '*.c' '*.h' '*.cc')
