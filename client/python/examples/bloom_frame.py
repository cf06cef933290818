# SPDX-License-Identifier: Apache-2.0
# bloom_frame.py IN.exr OUT.exr - one frame; what it reads and writes are whole EXR files.
import sys
import airy

with airy.Client() as client:
    frame = client.bloom(sys.argv[1], threshold=0.8)
    frame.save(sys.argv[2])
    print(f"{frame.plan}; error at most {frame.bound:.1e}; {frame.ms.total:.0f} ms")
