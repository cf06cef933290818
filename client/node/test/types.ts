// SPDX-License-Identifier: Apache-2.0
// types.ts - what a user writes, for the type checker: what must be accepted, and what must not. Never run.
import type { Writable } from 'node:stream';
import { Airy, AiryAbortError, AiryError, connect, type Params, type Result } from '../lib/index.js';

export async function accepted(into: Writable): Promise<void> {
  const airy: Airy = await connect({ path: '/run/airyd/airyd.sock', reconnect: { attempts: 3 }, busyRetries: 2 });
  const params: Params = { threshold: 1.5, psf: 'eye', look: 'jimenez', stages: 6, exposure: 'auto' };
  const exr: Result<Buffer> = await airy.bloom(Buffer.alloc(1), params, { exr: { part: '0', pixels: 'half' } });
  const floats = await airy.bloom(new Float32Array(12), {}, { raw: { width: 2, height: 2, channels: 'RGB' } });
  const first: number = floats.output[0]!;
  const halves: Uint16Array = (await airy.bloom(new Uint16Array(12), {}, { raw: { width: 2, height: 2 } })).output;
  const nothing: null = (await airy.bloom(Buffer.alloc(1), {}, { into, signal: AbortSignal.timeout(5) })).output;
  const bound: number = (await airy.plan(Buffer.alloc(1))).bound;
  const done: bigint = (await airy.status()).done;
  const digest: string = (await airy.asset(new ArrayBuffer(4))).digest;
  const nan: bigint | undefined = exr.targets[0]?.nonfinite?.nan;
  airy.stream(params, { highWaterMark: 2, onError: (error, index) => console.log(error.symbol, index) }).pipe(into);
  const wall: string = (await airy.wallOpen('wall: a\npanels:\n- {size: [8, 8]}\n', { keep: true })).name;
  const drive = await airy.bloom(new Float32Array(12), {}, { raw: { width: 2, height: 2 }, wall, priority: 5, deadlineMs: 100 });
  const light: number = drive.output[3 * drive.width * (drive.height - 1)]!;
  const shown: null = (await airy.bloom(Buffer.alloc(1), {}, { wall, show: true, presentNs: process.hrtime.bigint() })).output;
  const ready: boolean = (await airy.wallList(wall)).walls[0]!.boards.every((b) => b.state === 'ready');
  const red: number = (await airy.wallPreview(wall)).data[0]!;
  await airy.wallPattern(wall, 'led', { board: 'b', led: 3, level: 0.5 });
  await airy.wallClose(wall);
  airy.stream({}, { wall, show: true }).end();
  console.log(light, shown, ready, red, drive.need?.width, drive.stamp);
  console.log(first, halves, nothing, bound, done, digest, nan, exr.ms?.total);
  try {
    airy.close();
  } catch (error) {
    if (error instanceof AiryError && error.symbol === 'PARAM_RANGE')
      console.log(error.field, error.retryable);
    if (error instanceof AiryAbortError)
      console.log(error.cause);
  }
}

export async function refused(airy: Airy): Promise<void> {
  // @ts-expect-error no such parameter
  await airy.bloom(Buffer.alloc(1), { thresold: 1 });
  // @ts-expect-error no such look
  await airy.bloom(Buffer.alloc(1), { look: 'nice' });
  // @ts-expect-error a path is no frame
  await airy.bloom('frame.exr');
  // @ts-expect-error a wall has a name
  await airy.bloom(Buffer.alloc(1), {}, { wall: 7 });
  // @ts-expect-error counters are bigint
  const done: number = (await airy.status()).done;
  // @ts-expect-error made by connect() only
  new Airy();
  console.log(done);
}
