#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# usb_vhci.sh - the wall against a real kernel's USB, in a machine of its own: QEMU (by KVM where that is usable, else emulated)
# boots Debian's kernel with the daemon, its libraries, lavapipe, udevd and the tests of usb_vhci_guest in an initramfs. What is
# missing is downloaded from Debian and unpacked under the build folder; nothing is installed, the host's kernel is left alone.
# Emulated, lavapipe's first draw alone takes longer than the daemon's limit for a frame: there the wall is driven without the daemon
# (usb_vhci_drive.h). Prints TAP. Exits 0, 1, or 77 and one line where it cannot run. ACCEL=kvm or tcg and DRIVE=daemon or wall
# force one; LIMIT_S bounds the machine's life.
set -u
cd "$(dirname "$0")/.."
BUILD=${BUILD:-build}
LIMIT_S=${LIMIT_S:-900}
work=$PWD/$BUILD/usb_vhci
host=$work/host tree=$work/tree accel=${ACCEL:-} drive=${DRIVE:-}
modules="usb-common usbcore usbip-core vhci-hcd"

cannot() {
    echo "check-usb: cannot run here: $1"
    exit 77
}

# Unpacked into $host, once.
fetch() { # package...
    local stamp=$work/fetched
    [ "$(cat "$stamp" 2>/dev/null)" = "$*" ] && return
    command -v apt-get dpkg-deb >/dev/null || cannot "no apt-get and dpkg-deb, and packages of Debian are needed"
    rm -rf "$work/deb" "$host"
    mkdir -p "$work/deb" "$host"
    (cd "$work/deb" && apt-get -qq -o APT::Sandbox::User=root download "$@") >"$work/fetch.log" 2>&1 ||
        cannot "$(tail -1 "$work/fetch.log") (wanted: $*)"
    for deb in "$work/deb"/*.deb; do
        dpkg-deb -x "$deb" "$host" || cannot "$deb could not be unpacked"
    done
    rm -rf "$work/deb"
    echo "$*" >"$stamp"
}

fetch_all() {
    local image
    image=$(apt-cache depends linux-image-amd64 2>/dev/null | awk '/Depends: linux-image-/ { print $2; exit }')
    [ -n "$image" ] || cannot "apt knows of no linux-image-amd64 (apt-get update?)"
    fetch "$image" busybox-static udev cpio libkmod2
}

library() { # file: its libraries, one a line
    LD_LIBRARY_PATH=$host/lib/x86_64-linux-gnu:$host/usr/lib/x86_64-linux-gnu ldd "$1" 2>/dev/null |
        awk '/=> \// { print $3 } /^\t\// { print $1 } /not found/ { print "missing:" $1 }'
}

put() { # file path: into the tree, with its libraries at the paths where the loader looks
    install -D "$1" "$tree/$2" || exit 1
    local l
    for l in $(library "$1"); do
        case $l in missing:*) cannot "$1 needs ${l#missing:}, which is not here" ;; esac
        local to=${l#"$host"}
        [ -e "$tree/$to" ] || install -D "$l" "$tree/$to" || exit 1
    done
}

plant_daemon() {
    local icd driver
    put "$BUILD/airyd" airyd
    icd=$(ls /usr/share/vulkan/icd.d/lvp_icd*.json 2>/dev/null | head -1)
    [ -n "$icd" ] || cannot "no lavapipe (mesa-vulkan-drivers)"
    driver=$(sed -n 's/.*"library_path": *"\(.*\)".*/\1/p' "$icd")
    case $driver in /*) ;; *) driver=/usr/lib/x86_64-linux-gnu/$driver ;; esac
    put "$driver" "$driver"
    install -D "$icd" "$tree/usr/share/vulkan/icd.d/lvp_icd.json"
}

plant() {
    local m file
    rm -rf "$tree"
    mkdir -p "$tree/bin" "$tree/modules" "$tree/etc"
    install "$host/bin/busybox" "$tree/bin/busybox"
    install tests/usb_vhci_init "$tree/init"
    put "$host/bin/udevadm" bin/udevadm
    ln -s udevadm "$tree/bin/udevd"
    put "$BUILD/tests/usb_vhci_guest" usb_vhci_guest
    [ "$drive" = wall ] || plant_daemon
    for m in $modules; do
        file=$(find "$host/lib/modules" -name "$m.ko" | head -1)
        [ -n "$file" ] || cannot "Debian's kernel has no $m.ko"
        cp "$file" "$tree/modules/"
    done
    printf 'root:x:0:0:root:/tmp:/bin/sh\n' >"$tree/etc/passwd"
    printf 'root:x:0:\n' >"$tree/etc/group"
}

pack() {
    strip --strip-debug "$tree/usb_vhci_guest" "$tree/airyd" 2>/dev/null # where binutils are
    (cd "$tree" && find . -print0 | "$host/bin/cpio" --quiet --null -H newc -o) >"$work/initramfs" || exit 1
}

kernel() { # seconds accel argument...: the console's lines
    local limit=$1 accel=$2
    shift 2
    timeout "$limit" qemu-system-x86_64 -accel "$accel" -cpu max -smp 2 -m 2048 -nodefaults -no-user-config -display none \
        -no-reboot -serial stdio -kernel "$(ls "$host"/boot/vmlinuz-* | head -1)" "$@" </dev/null 2>>"$work/qemu.log" | tr -d '\r'
}

# A device node is no promise: inside some clouds' machines /dev/kvm opens, and its guests never say a word.
kvm_runs() {
    [ -r /dev/kvm ] && [ -w /dev/kvm ] &&
        kernel 20 kvm -append "console=ttyS0 panic=-1" | grep 'Linux version' >/dev/null
}

choose() {
    if [ -z "$accel" ]; then
        accel=tcg
        ! kvm_runs || accel=kvm
    fi
    [ -n "$drive" ] || { [ "$accel" = kvm ] && drive=daemon || drive=wall; }
}

boot() {
    echo "# accel $accel, drive $drive, initramfs $(du -m "$work/initramfs" | cut -f1) MB"
    kernel "$LIMIT_S" "$accel" -initrd "$work/initramfs" \
        -append "console=ttyS0 quiet loglevel=3 panic=-1 airy.drive=$drive" |
        tee "$work/console" | grep --line-buffered -E '^(ok|not ok|1\.\.|# )'
}

verdict() {
    local plan passed
    plan=$(sed -n 's/^1\.\.\([0-9]*\)$/\1/p' "$work/console" | head -1)
    passed=$(grep -cE '^ok ' "$work/console")
    if grep -qx 'exit status 0' "$work/console" && [ "$passed" = "${plan:-none}" ]; then
        echo "check-usb: $passed passed"
        return 0
    fi
    echo "check-usb: failed: $passed of ${plan:-?} tests passed; the console is $work/console"
    tail -3 "$work/qemu.log"
    tail -5 "$work/console"
    return 1
}

mkdir -p "$work"
: >"$work/qemu.log"
command -v qemu-system-x86_64 >/dev/null || cannot "no qemu-system-x86_64 (Debian: qemu-system-x86)"
fetch_all
choose
plant
pack
boot
verdict
