# SPDX-License-Identifier: Apache-2.0
"""watch_folder.py FROM TO - blooms every EXR that appears in FROM into TO, up to eight in flight, until it is stopped.

A file is taken once its size and time have not changed from one look to the next: renderers that write beside and rename are
served at once on the second look, others are not read half. A bad frame is said, and costs one frame."""
import asyncio
import sys
from pathlib import Path

import airy

LOOK_S = 0.5


async def frame(client: airy.aio.Client, source: Path, to: Path, places: asyncio.Semaphore) -> None:
    async with places:
        try:
            result = await client.bloom(source)
            await asyncio.to_thread(result.save, to / source.name)
            print(f"{source.name}: {result.ms.total:.0f} ms", flush=True)
        except (airy.AiryError, OSError) as e:
            print(f"{source.name}: {e}", file=sys.stderr, flush=True)


async def watch(source: Path, to: Path) -> None:
    seen: dict[Path, tuple[int, int]] = {}
    started: dict[Path, tuple[int, int]] = {}
    places = asyncio.Semaphore(8)
    async with airy.aio.Client() as client, asyncio.TaskGroup() as tasks:
        while True:
            for path in sorted(source.glob("*.exr")):
                st = path.stat()
                now = (st.st_size, st.st_mtime_ns)
                if seen.get(path) == now and started.get(path) != now:
                    started[path] = now
                    tasks.create_task(frame(client, path, to, places))
                seen[path] = now
            await asyncio.sleep(LOOK_S)


asyncio.run(watch(Path(sys.argv[1]), Path(sys.argv[2])))
