# SPDX-License-Identifier: Apache-2.0
# Everything is built under $(BUILD). `make help` lists the targets.
#
# Variants: make SAN=address,undefined (or thread) BUILD=build/asan; make CC=clang BUILD=build/clang.

BUILD ?= build
SAN ?=
CC ?= gcc
ifeq ($(origin CC),default)
CC := gcc
endif
CXX := $(if $(findstring clang,$(CC)),clang++,g++)

VERSION := 0.1.0

# What a bare Debian 12 needs; installed by `make deps` (part of demo and check) when missing.
PKGS_BUILD := gcc g++ pkg-config glslang-tools protobuf-c-compiler protobuf-compiler \
	libvulkan-dev libopenexr-dev libdeflate-dev libprotobuf-c-dev libsystemd-dev libpng-dev libxxhash-dev
PKGS_RUN := mesa-vulkan-drivers
PKGS_TEST := libcmocka-dev vulkan-validationlayers openexr

WARN := -Wall -Wextra -Werror -Wshadow -Wstrict-prototypes -Wmissing-prototypes -Wvla -Wformat=2
OPT := -O2 -g
CPPFLAGS := -D_GNU_SOURCE -DAIRY_BUILD -Iproto -Idaemon -Iclient -I$(BUILD)/gen
SANFLAGS := $(if $(SAN),-fsanitize=$(SAN) -fno-omit-frame-pointer)
CFLAGS += -std=c11 $(OPT) $(WARN) -fPIC -fvisibility=hidden -pthread -ffp-contract=off $(SANFLAGS)
CXXFLAGS += -std=c++17 $(OPT) -Wall -Wextra -Werror -fPIC -fvisibility=hidden -pthread $(SANFLAGS)
LDFLAGS += -pthread $(SANFLAGS)

pkgcflags = $(shell pkg-config --cflags $(1) 2>/dev/null | sed 's/-I/-isystem /g')
CPPFLAGS += $(call pkgcflags,OpenEXR libprotobuf-c)
LIBS_EXR := -lOpenEXR-3_1 -lOpenEXRCore-3_1 -lIex-3_1 -lIlmThread-3_1 -lImath-3_1 -ldeflate -lstdc++
LIBS_ENGINE := -lvulkan
LIBS_PROTO := -lprotobuf-c

# ---- rooms: one archive each, dependencies one way -------------------------------------------
ROOM_proto := $(wildcard proto/*.c)
ROOM_exr := $(wildcard daemon/exr*.c) daemon/frame.c
ROOM_engine := $(wildcard daemon/vk*.c daemon/bloom*.c) daemon/plan.c daemon/psf.c
ROOM_params := daemon/params.c
ROOM_server := $(wildcard daemon/server.c daemon/client.c daemon/job.c daemon/sched.c daemon/metrics.c)
ROOM_client := $(wildcard client/lib*.c)

obj = $(patsubst %.c,$(BUILD)/%.o,$(1))
PROTO_GEN := $(BUILD)/gen/airy.pb-c.c
ARCHIVES := $(foreach r,proto exr engine params server client,$(BUILD)/$(r).a)

.DEFAULT_GOAL := help
.PHONY: help all deps demo check bench clean format
.DELETE_ON_ERROR:
.SECONDARY:

help:
	@echo "make demo     build, start the daemon, bloom an HDR frame through the socket -> build/demo/"
	@echo "make check    build and pass the tests (installs what is missing, about 10 minutes)"
	@echo "make all      build/airyd (daemon), build/airy (command), build/libairy.so and .a"
	@echo "make bench    speed: medians and ratios on this machine"
	@echo "make install  to PREFIX (default /usr/local), DESTDIR honoured"
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
	protoc-c --proto_path=proto --c_out=$(BUILD)/gen proto/airy.proto

include shaders/shaders.mk

# ---- compile --------------------------------------------------------------------------------------
$(BUILD)/%.o: %.c | $(BUILD)/gen/airy.pb-c.h $(SPIRV)
	@mkdir -p $(@D)
	$(CC) $(CPPFLAGS) $(CFLAGS) -MMD -MP -c $< -o $@

$(BUILD)/%.o: %.cc
	@mkdir -p $(@D)
	$(CXX) $(CPPFLAGS) $(CXXFLAGS) -MMD -MP -c $< -o $@

$(BUILD)/gen/airy.pb-c.o: $(BUILD)/gen/airy.pb-c.c
	$(CC) $(CPPFLAGS) -std=c11 $(OPT) -fPIC -fvisibility=hidden $(SANFLAGS) -c $< -o $@

# Pixel loops that the compiler vectorises.
$(BUILD)/daemon/frame.o $(BUILD)/daemon/exr_zip.o: CFLAGS += -O3

$(BUILD)/proto.a: $(call obj,$(ROOM_proto)) $(BUILD)/gen/airy.pb-c.o
$(BUILD)/exr.a: $(call obj,$(ROOM_exr)) $(patsubst %.cc,$(BUILD)/%.o,$(wildcard daemon/exr*.cc))
$(BUILD)/engine.a: $(call obj,$(ROOM_engine))
$(BUILD)/params.a: $(call obj,$(ROOM_params))
$(BUILD)/server.a: $(call obj,$(ROOM_server))
$(BUILD)/client.a: $(call obj,$(ROOM_client))
$(ARCHIVES):
	@rm -f $@
	ar rcs $@ $^

DAEMON_LIBS := $(BUILD)/server.a $(BUILD)/engine.a $(BUILD)/exr.a $(BUILD)/params.a $(BUILD)/proto.a
$(BUILD)/airyd: $(BUILD)/daemon/main.o $(DAEMON_LIBS)
	$(CC) $(LDFLAGS) $^ -o $@ $(LIBS_ENGINE) $(LIBS_EXR) $(LIBS_PROTO) -lsystemd -lm

$(BUILD)/libairy.a: $(call obj,$(ROOM_client) $(ROOM_proto)) $(BUILD)/gen/airy.pb-c.o
	@rm -f $@
	ar rcs $@ $^
$(BUILD)/libairy.so: $(call obj,$(ROOM_client) $(ROOM_proto)) $(BUILD)/gen/airy.pb-c.o
	$(CC) $(LDFLAGS) -shared -Wl,-soname,libairy.so.0 $^ -o $@ $(LIBS_PROTO)
$(BUILD)/airy.h: client/airy.h
	@mkdir -p $(@D)
	cp $< $@

-include $(shell find $(BUILD) -name '*.d' 2>/dev/null)

include client/client.mk tests/tests.mk

clean:
	rm -rf $(BUILD)
format:
	clang-format -i $(shell git ls-files '*.c' '*.h' '*.cc')
