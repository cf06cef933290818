#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# build.sh - turns DIR/root, a staged install below /usr, into a Debian package: DIR VERSION ARCH OUT. `make deb` calls it. No
# debhelper: what it would generate is a page, and here to be read.
set -eu
dir=$1 version=$2 arch=$3 out=$4
here=$(cd "$(dirname "$0")" && pwd)
root=$dir/root
doc=$root/usr/share/doc/airyd

strip --strip-unneeded --remove-section=.comment "$root/usr/bin/airyd" "$root/usr/bin/airy" "$root"/usr/lib/*/libairy.so.0
strip --strip-debug "$root"/usr/lib/*/libairy.a
find "$root/usr/share/man" -type f -exec gzip -9n {} +
{
    echo 'Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/'
    echo
    echo 'Files: *'
    echo 'Copyright: the authors of airyd'
    echo 'License: Apache-2.0'
    echo ' On Debian systems the text is in /usr/share/common-licenses/Apache-2.0.'
} >"$doc/copyright"
rm -f "$doc/LICENSE"

# dpkg-shlibdeps wants a source's control file in the folder where it runs.
mkdir -p "$dir/debian" "$root/DEBIAN"
printf 'Source: airyd\n\nPackage: airyd\nArchitecture: any\n' >"$dir/debian/control"
# libairy.so.0 is in this very package, and none of its programs is linked with it.
needs=$(cd "$dir" && dpkg-shlibdeps -O -eroot/usr/bin/airyd -eroot/usr/bin/airy $(find root/usr/lib -name 'libairy.so.0' -printf '-e%p ')) ||
    { echo "airyd: dpkg-shlibdeps does not know what the programs need" >&2; exit 1; }
needs=${needs#shlibs:Depends=}
size=$(du -sk --exclude=DEBIAN "$root" | cut -f1)
sed "/^#/d; s|@VERSION@|$version|; s|@ARCH@|$arch|; s|@SIZE@|$size|; s|@SHLIBS@|$needs|" "$here/control.in" >"$root/DEBIAN/control"
install -m 755 "$here/postinst" "$here/prerm" "$here/postrm" "$root/DEBIAN/"
install -m 644 "$here/triggers" "$root/DEBIAN/"
(cd "$root" && find usr -type f -exec md5sum {} +) >"$root/DEBIAN/md5sums"
find "$root" -type d -exec chmod 755 {} +
dpkg-deb --root-owner-group -Zxz --build "$root" "$out"
