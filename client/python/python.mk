# SPDX-License-Identifier: Apache-2.0
# python.mk - the Python package, ready to be imported from $(BUILD)/python. The daemon's build does not need it.

PKGS_TEST += python3-protobuf python3-numpy python3-setuptools python3-wheel mypy

PY_SOURCES := $(wildcard client/python/airy/*.py client/python/airy/*.pyi) client/python/airy/py.typed
PY_MODULES := $(patsubst client/python/%,$(BUILD)/python/%,$(PY_SOURCES))

$(BUILD)/python/airy/%: client/python/airy/%
	@mkdir -p $(@D)
	$(Q)cp $< $@
$(BUILD)/python/airy/airy_pb2.py: proto/airy.proto
	@mkdir -p $(@D)
	$(call say,PROTOC $@)
	$(Q)protoc --proto_path=proto --python_out=$(@D) $<

.PHONY: python
python: $(PY_MODULES) $(BUILD)/python/airy/airy_pb2.py
