# SPDX-License-Identifier: Apache-2.0
# report.mk - `make report`: $(BUILD)/report/index.html and its CSV files. `make report REPORT=--quick` takes about a
# minute. Installs nothing: what is not there (peers, a folder of frames, a browser) is left out, and the page says so.

REPORT ?=
REPORT_SOURCES := $(addprefix tests/report/,airy_report.c grid.c method_box.c method_c_chain.c method_direct.c \
	method_dual.c method_fft.c method_kawase.c method_recursive.c method_tent.c pyramid.c run_cost.c run_speed.c sheet.c \
	subject.c) $(addprefix tests/bench/,c_chain.c codec.c jobs.c measure.c scene.c team.c)
PAGE_SOURCES := $(addprefix tests/report/,report_page.c page_csv.c page_plot.c page_sections.c)

$(BUILD)/tests/report/%.o: CPPFLAGS += -Itests/bench -Itests/reference
# As the yardstick of the bench: what the compiler has for this very CPU, as the device's driver does.
$(call obj,$(filter tests/report/method_%,$(REPORT_SOURCES)) tests/report/pyramid.c tests/report/grid.c): \
	CFLAGS += -O3 -march=native -fno-trapping-math -ffp-contract=fast
$(BUILD)/tests/report/subject.o: CFLAGS += -O3

$(BUILD)/bench/airy_report: $(call obj,$(REPORT_SOURCES) tests/reference/reference.c) $(ARCHIVES)
	@mkdir -p $(@D)
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $(filter %.o,$^) -o $@ $(BENCH_LIBS)

$(BUILD)/bench/report_page: $(call obj,$(PAGE_SOURCES))
	@mkdir -p $(@D)
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $^ -o $@ -lm

$(BUILD)/bench/peer_frame: $(call obj,tests/report/peer_frame.c client/demo/picture.c)
	@mkdir -p $(@D)
	$(call say,LD $@)
	$(Q)$(CC) $(LDFLAGS) $^ -o $@ -lOpenEXRCore-3_1 -lm
$(BUILD)/tests/report/peer_frame.o: CPPFLAGS += -Iclient/demo

REPORT_TOOLS := $(addprefix $(BUILD)/,bench/airy_report bench/report_page bench/peer_frame demo/scene demo/tonemap)

.PHONY: report report-tools
report-tools: all $(REPORT_TOOLS)
# test_hard is made where its source is there: the page then has its table.
report: report-tools $(filter $(T)/test_hard,$(TESTS))
	@BUILD=$(BUILD) bash tests/report/report.sh $(REPORT)
# tests/test_report.sh makes a small one, with what is not sanitised.
tests: $(if $(SAN),,$(REPORT_TOOLS))
