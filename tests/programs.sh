# SPDX-License-Identifier: Apache-2.0
# programs.sh - what is tested: AIRY, AIRYD and SCENE name the programs, else they are those of BUILD. Sourced at the root.
export BUILD=${BUILD:-build} AIRY AIRYD SCENE
AIRY=$(realpath "${AIRY:-$BUILD/airy}")
AIRYD=$(realpath "${AIRYD:-$BUILD/airyd}")
SCENE=$(realpath "${SCENE:-$BUILD/demo/scene}")
unset AIRY_SOCKET

# Debian's python3 has Debian's protobuf; another one first in PATH may not. Prints its name, or nothing.
find_python() {
    local p
    for p in python3 /usr/bin/python3; do
        "$p" -c 'import sys, google.protobuf; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo "$p" && return
    done
}
