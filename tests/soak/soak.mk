# SPDX-License-Identifier: Apache-2.0
# soak.mk - `make soak`: a real daemon under mixed clients and faults for MINUTES, then killed in ROUNDS. SEED= chooses the same again.
# `make soak-scenes`: random scenes, each of a new seed, for MINUTES against the float64 reference; it ends in the worst ratio of error to stated
# bound, and a failure prints the seed that makes its scene again.

MINUTES ?= 30
ROUNDS ?= 200
SEED ?= $(shell date +%s)

.PHONY: soak soak-scenes
soak: all $(BUILD)/demo/scene python
	@BUILD=$(BUILD) MINUTES=$(MINUTES) ROUNDS=$(ROUNDS) SEED=$(SEED) bash tests/soak/soak.sh
soak-scenes: $(T)/test_property
	AIRY_SEED=$(SEED)000 AIRY_MINUTES=$(MINUTES) $(T)/test_property
