# SPDX-License-Identifier: Apache-2.0
"""batch_folder.py FROM TO [NAME=VALUE...] - blooms every EXR of a folder, eight in flight, with a line of progress.

What is in TO already is left out, so it can be started again; a bad frame is said, and costs one frame: the exit status is then 1."""
import asyncio
import sys
import time
from pathlib import Path

import airy


async def main(source: Path, to: Path, params: dict[str, str]) -> int:
    todo = [p for p in sorted(source.glob("*.exr")) if not (to / p.name).exists()]
    places = asyncio.Semaphore(8)
    done = failed = 0
    began = time.monotonic()

    async def frame(path: Path) -> None:
        nonlocal done, failed
        async with places:
            try:
                result = await client.bloom(path, **params)
                await asyncio.to_thread(result.save, to / path.name)
            except (airy.AiryError, OSError) as e:
                failed += 1
                print(f"\r\x1b[K{path.name}: {e}", file=sys.stderr)
            done += 1
            rate = done / max(time.monotonic() - began, 1e-3)
            left = (len(todo) - done) / rate
            print(f"\r\x1b[K{done}/{len(todo)}  {rate:.1f} frames/s  {left:.0f} s left", end="", file=sys.stderr, flush=True)

    async with airy.aio.Client() as client:
        await asyncio.gather(*(frame(p) for p in todo))
    print(f"\n{done - failed} of {len(todo)} frames bloomed", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    pairs = dict(a.split("=", 1) for a in sys.argv[3:])
    sys.exit(asyncio.run(main(Path(sys.argv[1]), Path(sys.argv[2]), pairs)))
