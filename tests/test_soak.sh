#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# test_soak.sh - the short form of `make soak`: the same clients, faults and kills on small frames. Prints TAP; SEED= repeats its choices.
cd "$(dirname "$0")/.." || exit 1
LOAD_SECONDS=${LOAD_SECONDS:-4} ROUNDS=${ROUNDS:-2} LARGE=0 exec bash tests/soak/soak.sh
