#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# peers.sh DIR [TURNS [WIDTH HEIGHT]] - other programs on the same frame, where they are installed, in turns; the median of
# the whole command's time, and the error of what it wrote: DIR/peers.csv. Installs nothing: what is not there is a line
# of DIR/notes.csv. AIRY_REPORT_PEERS=none: only airy with a daemon that runs.
set -u
BUILD=${BUILD:-build}
dir=$(realpath "$1") turns=${2:-3} width=${3:-1920} height=${4:-1080}
AIRY=$(realpath "${AIRY:-$BUILD/airy}")
frame=$(realpath "$BUILD/bench/peer_frame")
export AIRYD
AIRYD=$(realpath "${AIRYD:-$BUILD/airyd}")
work=$(mktemp -d "${TMPDIR:-/tmp}/airy-peers-XXXXXX")
daemon=
finish() {
    [ -n "$daemon" ] && kill -TERM "$daemon" 2>/dev/null && wait "$daemon"
    rm -rf "$work"
}
trap finish EXIT
note() { printf '"peers","%s"\n' "$(printf %s "$1" | tr '"\n' "' ")" >>"$dir/notes.csv"; }

"$frame" make "$width" "$height" "$work/in.pfm" "$work/in.exr" || exit 1
cd "$work" || exit 1

# The glow's peak near 1, as the point: so that float32 holds both.
gain=2513.274
bloom() {
    rm -f airy.exr
    "$AIRY" bloom in.exr airy.exr --force --quiet --pixels float --bright channel --threshold 0 --tolerance 1e-3 --intensity $gain \
        --psf 'gaussians:sigma=20,weight=1' "$@"
}
airy_warm() { bloom --socket "$work/s"; }
airy_alone() { bloom; }
gmic_blur() { gmic v - in.pfm blur 20,0,1 o gmic.pfm; }
gegl_blur() { gegl in.exr -o gegl.exr -- gegl:gaussian-blur std-dev-x=20 std-dev-y=20; }
python() { /usr/bin/python3 -c "$1"; }
pfm='
import numpy as np
def load(name):
    with open(name, "rb") as f:
        f.readline(); w, h = map(int, f.readline().split()); f.readline()
        return np.frombuffer(f.read(), "<f4").reshape(h, w, 3)[::-1].copy()
def save(name, a):
    with open(name, "wb") as f:
        f.write(b"PF\n%d %d\n-1.0\n" % (a.shape[1], a.shape[0])); f.write(a[::-1].astype("<f4").tobytes())
'
opencv_direct() { python "$pfm
import cv2
save('cv2.pfm', cv2.GaussianBlur(load('in.pfm'), (0, 0), 20, borderType=cv2.BORDER_CONSTANT))"; }
# pyrDown and pyrUp add a variance of 1 a cell each: what is left of sigma^2 is the kernel's, at 1/8 size.
opencv_pyramid() { python "$pfm
import cv2
a = load('in.pfm'); sizes = []
for _ in range(3):
    sizes.append((a.shape[1], a.shape[0])); a = cv2.pyrDown(a)
a = cv2.GaussianBlur(a, (0, 0), ((400 - 42) / 64) ** .5)
for s in reversed(sizes):
    a = cv2.pyrUp(a, dstsize=s)
save('pyr.pfm', a)"; }
scipy_fft() { python "$pfm
from scipy.signal import fftconvolve
x = np.arange(-80, 81); g = np.exp(-x * x / 800.); g /= g.sum()
a = load('in.pfm')
save('fft.pfm', np.stack([fftconvolve(a[..., c], np.outer(g, g).astype('f4'), 'same') for c in range(3)], 2))"; }

# name | function | what it wrote | gain | added | version
peers=()
add() { peers+=("$1|$2|$3|$4|$5|$6"); }
"$AIRYD" --warm common --socket "$work/s" 2>airyd.log &
daemon=$!
for _ in $(seq 300); do "$AIRY" status --socket "$work/s" >/dev/null 2>&1 && break; sleep .1; done
version=$("$AIRY" --version 2>&1 | head -1)
add 'airy, with a daemon that runs' airy_warm airy.exr $gain 1 "$version"
wanted() { [ "${AIRY_REPORT_PEERS:-}" != none ]; }
wanted && add 'airy, the whole command with its own daemon' airy_alone airy.exr $gain 1 "$version"
packaged() { dpkg-query -W -f='${Package} ${Version}' "$1" 2>/dev/null; }
there() { wanted && command -v "$1" >/dev/null; }
if there gmic; then add "G'MIC blur (Gaussian)" gmic_blur gmic.pfm 1 0 "$(packaged gmic)"; else note "gmic is not installed or not wanted"; fi
if there gegl; then add 'GEGL gaussian-blur' gegl_blur gegl.exr 1 0 "$(packaged gegl)"; else note "gegl is not installed or not wanted"; fi
has() { wanted && /usr/bin/python3 -c "import $1" 2>/dev/null; }
if has cv2; then
    add 'OpenCV GaussianBlur, Python' opencv_direct cv2.pfm 1 0 "$(python 'import cv2; print(cv2.__version__)')"
    add 'OpenCV pyramid, Python' opencv_pyramid pyr.pfm 1 0 "$(python 'import cv2; print(cv2.__version__)')"
else
    note "OpenCV is not installed for /usr/bin/python3, or not wanted"
fi
if has scipy; then
    add 'scipy FFT, Python' scipy_fft fft.pfm 1 0 "$(python 'import scipy; print(scipy.__version__)')"
else
    note "scipy is not installed for /usr/bin/python3, or not wanted"
fi

for turn in $(seq 0 "$turns"); do # the first warms the page cache
    for i in "${!peers[@]}"; do
        IFS='|' read -r name fn _ <<<"${peers[$i]}"
        [ -e "failed.$i" ] && continue
        start=$(date +%s%N)
        $fn >"log.$i" 2>&1 || { : >"failed.$i"; note "$name failed: $(tail -1 "log.$i")"; continue; }
        [ "$turn" -gt 0 ] && echo $((($(date +%s%N) - start) / 1000)) >>"us.$i"
    done
done

echo "program,version,ms,ratio_to_warm_airy,error" >"$dir/peers.csv"
base=
for i in "${!peers[@]}"; do
    [ -e "failed.$i" ] && continue
    IFS='|' read -r name _ file gain added version <<<"${peers[$i]}"
    if ! error=$("$frame" error "$file" "$gain" "$added" 2>&1); then
        note "$name: $error"
        continue
    fi
    us=$(sort -n "us.$i" | sed -n "$(((turns + 1) / 2))p")
    base=${base:-$us}
    awk -v n="$name" -v v="$version" -v us="$us" -v b="$base" -v e="$error" \
        'BEGIN { printf "\"%s\",\"%s\",%.0f,%.2f,%s\n", n, v, us / 1000, us / b, e }' >>"$dir/peers.csv"
done
