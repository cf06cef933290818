# SPDX-License-Identifier: Apache-2.0
# install.mk - where everything goes, and the Debian package of it. systemd, sysusers and udev look below /usr and /usr/local alike:
# for both prefixes their files go to $(PREFIX)/lib, and nothing outside PREFIX is touched.
PREFIX ?= /usr/local
LIBDIR ?= $(PREFIX)/lib
DESTDIR ?=
VERSION := $(shell sed -n 's/^.define AIRY_VERSION "\(.*\)"/\1/p' client/airy.h)
MAN_PAGES := $(wildcard $(foreach n,1 3 5 7 8,client/*.$(n) proto/*.$(n) daemon/*.$(n) daemon/wall/*.$(n)))

I = $(DESTDIR)$(PREFIX)
I_LIB = $(DESTDIR)$(LIBDIR)
# Units name their program by its path.
at_prefix = sed 's|/usr/local/bin/|$(PREFIX)/bin/|' $(1) >$(2) && chmod 644 $(2)

install: all
	install -d $(I)/bin $(I)/include $(I_LIB)/pkgconfig $(I)/share/doc/airyd/examples \
	  $(I)/lib/systemd/system $(I)/lib/systemd/user $(I)/lib/sysusers.d $(I)/lib/udev/rules.d
	install -m 755 $(BUILD)/airyd $(BUILD)/airy $(I)/bin/
	install -m 755 $(BUILD)/libairy.so $(I_LIB)/libairy.so.0
	ln -sf libairy.so.0 $(I_LIB)/libairy.so
	install -m 644 $(BUILD)/libairy.a $(I_LIB)/
	install -m 644 client/airy.h $(I)/include/
	sed 's|@PREFIX@|$(PREFIX)|; s|@LIBDIR@|$(LIBDIR)|; s|@VERSION@|$(VERSION)|' systemd/libairy.pc.in >$(I_LIB)/pkgconfig/libairy.pc
	chmod 644 $(I_LIB)/pkgconfig/libairy.pc
	for page in $(MAN_PAGES); do \
	  install -D -m 644 $$page $(I)/share/man/man$${page##*.}/$${page##*/} || exit 1; done
	install -m 644 README.md LICENSE proto/PROTOCOL.md proto/airy.proto $(I)/share/doc/airyd/
	install -m 644 client/farm/opencue.md client/farm/deadline.md $(I)/share/doc/airyd/
	install -D -m 755 client/farm/airy-slurm.sh $(I)/share/airy/airy-slurm.sh
	$(call at_prefix,systemd/airyd.service,$(I)/lib/systemd/system/airyd.service)
	install -m 644 systemd/airyd.socket $(I)/lib/systemd/system/
	$(call at_prefix,systemd/user/airyd.service,$(I)/lib/systemd/user/airyd.service)
	install -m 644 systemd/user/airyd.socket $(I)/lib/systemd/user/
	$(call at_prefix,systemd/gpu.conf,$(I)/share/doc/airyd/examples/gpu.conf)
	$(call at_prefix,systemd/wall.conf,$(I)/share/doc/airyd/examples/wall.conf)
	install -m 644 systemd/airyd.sysusers $(I)/lib/sysusers.d/airyd.conf
	install -m 644 systemd/70-airy-wall.rules $(I)/lib/udev/rules.d/

# A staged install, stripped; what it needs is read out of its programs (dpkg-shlibdeps, of the package dpkg-dev).
DEB_ARCH = $(shell dpkg --print-architecture)
DEB := $(BUILD)/deb
deb: all
	@command -v dpkg-shlibdeps >/dev/null || { echo "airyd: make deb needs the package dpkg-dev"; exit 1; }
	@rm -rf $(DEB)
	@$(MAKE) --no-print-directory install PREFIX=/usr LIBDIR=/usr/lib/$$(dpkg-architecture -qDEB_HOST_MULTIARCH) DESTDIR=$(DEB)/root >/dev/null
	@sh systemd/deb/build.sh $(DEB) $(VERSION) $(DEB_ARCH) $(BUILD)/airyd_$(VERSION)_$(DEB_ARCH).deb
