// SPDX-License-Identifier: Apache-2.0
// live.mjs - the client against real daemons: bytes, numbers, pipelines, cancelling, slow readers, daemons that are killed, streams, and
// the examples as a user starts them.
import assert from 'node:assert/strict';
import { spawn } from 'node:child_process';
import { createHash } from 'node:crypto';
import { mkdirSync, readdirSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { Readable, Writable } from 'node:stream';
import { pipeline } from 'node:stream/promises';
import { fileURLToPath } from 'node:url';
import { connect } from '../lib/index.js';
import { check, commandBytes, falseDaemon, halfToNumber, Peer, rejects, run, scene, socketPath, sparks, startDaemon, stopDaemon, until, work } from './kit.mjs';

const PSF = 'gaussians:sigma=2/8,weight=0.2/0.1';
const FAST = { psf: PSF };
const OPTIONS = ['--warm', 'common'];
const example = (name) => fileURLToPath(new URL(`../examples/${name}`, import.meta.url));
const digest = (bytes) => createHash('sha256').update(bytes).digest('hex');
const frames = (n) => Array.from({ length: n }, (_, i) => ({ params: { ...FAST, threshold: 0.3 + i / 10 } }));

async function bytesAndNumbers(daemon) {
  const airy = await connect({ path: daemon.path });
  await check('an EXR comes back as the airy command writes it', async () => {
    const { file, bytes } = await scene(640, 360), before = digest(bytes);
    const result = await airy.bloom(bytes, { threshold: 0.5, psf: PSF }, { exr: { compression: 'piz' } });
    assert.ok(result.output.equals(await commandBytes(daemon, file, ['--threshold', '0.5', '--psf', PSF, '--compression', 'piz'])));
    assert.equal(digest(bytes), before);
    assert.ok(result.bound > 0 && result.bound <= 1e-3 && result.energy.bloomed > 0);
    assert.equal(result.targets[0].width, 640);
    assert.ok(result.chunks > 0);
  });
  await check('a 4K frame of half RGBA, 66 MB inline: its alpha is untouched, its light is accounted for', async () => {
    const input = sparks({ width: 3840, height: 2160, type: 'PIXEL_HALF', channels: ['R', 'G', 'B', 'A'] });
    assert.equal(input.byteLength, 66_355_200);
    const { output, energy } = await airy.bloom(input, FAST, { raw: { width: 3840, height: 2160, channels: 'RGBA' } });
    assert.ok(output instanceof Uint16Array && output.length === input.length);
    const table = Float64Array.from({ length: 65536 }, (_, h) => halfToNumber(h));
    let before = 0, after = 0;
    for (let i = 0; i < output.length; i += 4) {
      if (output[i + 3] !== 0x3c00)
        assert.fail(`alpha of pixel ${i / 4} is 0x${output[i + 3].toString(16)}, expected 0x3c00`);
      before += table[input[i]] + table[input[i + 1]] + table[input[i + 2]];
      after += table[output[i]] + table[output[i + 1]] + table[output[i + 2]];
    }
    assert.ok(Math.abs(energy.input / before - 1) < 1e-6, `${energy.input}, ${before}`);
    // Half an ulp of every sample at most, and that is of random sign.
    assert.ok(energy.bloomed > 0.05 * before && Math.abs((after - before) / energy.bloomed - 1) < 2e-3, `${after - before}, ${energy.bloomed}`);
  });
  await check('planar and interleaved floats are the same picture', async () => {
    const width = 64, height = 48, n = width * height;
    const woven = sparks({ width, height, type: 'PIXEL_FLOAT', channels: ['R', 'G', 'B'] }), planar = new Float32Array(n * 3);
    for (let i = 0; i < n; i++)
      for (let c = 0; c < 3; c++)
        planar[c * n + i] = woven[3 * i + c];
    const a = await airy.bloom(woven, FAST, { raw: { width, height } });
    const channels = ['R', 'G', 'B'].map((name, c) => ({ name, offset: c * n * 4, rowStride: width * 4, pixelStride: 4 }));
    const b = await airy.bloom(planar, FAST, { raw: { width, height, channels } });
    const c = await airy.bloom(Buffer.from(woven.buffer), FAST, { raw: { width, height, type: 'float', channels: 'RGB' } });
    assert.ok(a.output instanceof Float32Array && Buffer.isBuffer(c.output));
    assert.ok(a.output.some((v, i) => v > woven[i]), 'something glows');
    for (let i = 0; i < n; i++)
      for (let k = 0; k < 3; k++)
        assert.equal(b.output[k * n + i], a.output[3 * i + k]);
    assert.ok(c.output.equals(Buffer.from(a.output.buffer, a.output.byteOffset, a.output.byteLength)));
  });
  await check('a view into a larger buffer is sent, and no byte beside it', async () => {
    const { bytes } = await scene(192, 108), around = Buffer.alloc(bytes.length + 100, 0xff);
    bytes.copy(around, 50);
    const view = new Uint8Array(around.buffer, around.byteOffset + 50, bytes.length);
    assert.ok((await airy.bloom(view, FAST)).output.equals((await airy.bloom(bytes, FAST)).output));
  });
  await check('a plan, an asset, a status', async () => {
    const { bytes } = await scene(192, 108);
    const plan = await airy.plan(bytes, { psf: PSF, tolerance: 1e-4 });
    assert.ok(plan.output === null && plan.bound > 0 && plan.bound <= 1e-4 && plan.targets[0].predictedMs > 0);
    const { digest: name, width, height } = await airy.asset(bytes);
    assert.deepEqual([width, height], [192, 108]);
    const dirty = await airy.bloom(bytes, { ...FAST, dirt: name }), clean = await airy.bloom(bytes, FAST);
    assert.ok(!dirty.output.equals(clean.output));
    const status = await airy.status();
    assert.ok(status.done > 0n && status.clients >= 1 && !status.draining);
    assert.equal(status.device.name, airy.device.name);
  });
  await check('calls that cannot be meant are refused before anything is sent', async () => {
    const { bytes } = await scene(192, 108), before = (await airy.status()).bytesIn;
    const wrong = [
      [airy.bloom('frame.exr'), 'input'], [airy.bloom(null), 'input'], [airy.asset(7), 'input'],
      [airy.bloom(bytes, { threshold: NaN }), 'params.threshold'], [airy.bloom(bytes, { psf: {} }), 'params.psf'],
      [airy.bloom(bytes, { psf: 'a\0b' }), 'body.params[0].text'.slice(5)],
      [airy.bloom(new Float32Array(12)), 'raw'], [airy.bloom(bytes, {}, { raw: { width: 1, height: 1 } }), 'raw.type'],
      [airy.bloom(new Float32Array(12), {}, { raw: { width: 2, height: 2, type: 'half' } }), 'raw.type'],
      [airy.bloom(bytes, {}, { raw: { width: 1, height: 1, type: 'half', channels: [] } }), 'raw.channels'],
      [airy.bloom(bytes, {}, { raw: { width: -1, height: 1, type: 'half' } }), 'raw.width'],
      [airy.bloom(bytes, {}, { raw: {}, exr: {} }), 'raw'],
    ];
    for (const [promise, field] of wrong)
      await rejects(promise, { symbol: 'ARGUMENT', code: 0, field, origin: 'client', retryable: false });
    await rejects(airy.bloom(bytes, { psf: 'x'.repeat(70_000) }), { symbol: 'TOO_LONG', origin: 'client' });
    await rejects(connect({ path: daemon.path, busyRetries: -1 }), { symbol: 'ARGUMENT', field: 'busyRetries' });
    assert.throws(() => airy.stream({}, { highWaterMark: 0 }), { symbol: 'ARGUMENT' });
    assert.equal((await airy.status()).bytesIn, before);
  });
  airy.close();
}

async function inFlight(daemon) {
  const airy = await connect({ path: daemon.path });
  const { bytes } = await scene(192, 108);
  await check('eight requests at once have the bytes that each has alone', async () => {
    const wanted = [];
    for (const { params } of frames(8))
      wanted.push(digest((await airy.bloom(bytes, params)).output));
    assert.equal(new Set(wanted).size, 8);
    const got = await Promise.all(frames(8).map(({ params }) => airy.bloom(bytes, params)));
    assert.deepEqual(got.map((r) => digest(r.output)), wanted);
  });
  await check('more requests than the daemon allows wait here: none is refused', async () => {
    const small = await startDaemon([...OPTIONS, '--max-requests', '2', '--max-frame-bytes', '256K']);
    const one = await connect({ path: small.path, busyRetries: 0 });
    assert.equal(one.limits.maxRequests, 2);
    const results = await Promise.all(Array.from({ length: 20 }, () => one.bloom(bytes, FAST)));
    assert.equal(new Set(results.map((r) => digest(r.output))).size, 1);
    const { done, failed } = await one.status();
    assert.deepEqual([done, failed], [20n, 0n]);
    one.close();
    await stopDaemon(small);
  });
  const big = sparks({ width: 3840, height: 2160, type: 'PIXEL_HALF', channels: ['R', 'G', 'B'] });
  const raw = { width: 3840, height: 2160 };
  await check('cancelled half-way up: the promise ends, the daemon says CANCELLED, the connection goes on', async () => {
    const before = (await airy.status()).cancelled, stop = new AbortController(), why = new Error('changed my mind');
    const request = airy.bloom(big, FAST, { raw, signal: stop.signal });
    setTimeout(() => stop.abort(why), 5);
    const error = await rejects(request, { symbol: 'CANCELLED', name: 'AbortError', code: 0, origin: 'client' });
    assert.equal(error.cause, why);
    await until(() => airy.pending === 0, 'the daemon ends the request');
    assert.equal((await airy.status()).cancelled, before + 1n);
    assert.ok((await airy.bloom(bytes, FAST)).output.length > 0);
  });
  await check('cancelled before it is sent, while it waits, and after its end', async () => {
    const before = await airy.status();
    await rejects(airy.bloom(bytes, FAST, { signal: AbortSignal.abort() }), { symbol: 'CANCELLED' });
    await rejects(airy.status({ signal: AbortSignal.abort() }), { symbol: 'CANCELLED' });
    const after = new AbortController();
    const { output } = await airy.bloom(bytes, FAST, { signal: after.signal });
    after.abort();
    assert.ok(output.length > 0);
    assert.equal((await airy.status()).cancelled, before.cancelled);
  });
  await check('of forty requests every second one is cancelled, and the others are right', async () => {
    const right = digest((await airy.bloom(bytes, FAST)).output);
    const all = Array.from({ length: 40 }, (_, i) => {
      const stop = new AbortController();
      if (i % 2)
        setTimeout(() => stop.abort(), i);
      return airy.bloom(bytes, FAST, { signal: stop.signal }).then((r) => digest(r.output), (e) => e.symbol);
    });
    const ends = await Promise.all(all);
    ends.forEach((end, i) => assert.ok(end === right || (i % 2 && end === 'CANCELLED'), `${i}: ${end}`));
    assert.ok(ends.includes('CANCELLED'));
    await until(() => airy.pending === 0, 'all have ended');
  });
  await check('into a slow Writable: it gets the bytes, never more than it can hold, and the daemon waits', async () => {
    const part = big.subarray(0, 3840 * 400 * 3), layout = { width: 3840, height: 400 };
    const right = digest((await airy.bloom(part, FAST, { raw: layout })).output);
    const hash = createHash('sha256');
    let most = 0, size = 0;
    const slow = new Writable({
      highWaterMark: 256 * 1024,
      write(chunk, encoding, next) {
        most = Math.max(most, this.writableLength);
        size += chunk.length;
        hash.update(chunk);
        setTimeout(next, 2);
      },
    });
    const result = await airy.bloom(part, FAST, { raw: layout, into: slow });
    await new Promise((resolve) => slow.end(resolve));
    assert.equal(result.output, null);
    assert.deepEqual([result.size, size], [part.byteLength, part.byteLength]);
    assert.equal(hash.digest('hex'), right);
    // One read of the socket may be over the mark.
    assert.ok(most >= 65536 && most <= (256 + 64) * 1024, `${most} bytes were held`);
  });
  await check('a Writable that fails ends its request, and no other', async () => {
    const broken = new Writable({ write: (chunk, encoding, next) => next(new Error('disk full')) });
    const other = airy.bloom(bytes, FAST);
    const error = await rejects(airy.bloom(bytes, FAST, { into: broken }), { symbol: 'ARGUMENT', field: 'into' });
    assert.equal(error.cause.message, 'disk full');
    assert.ok((await other).output.length > 0);
    await until(() => airy.pending === 0, 'the daemon ends the request');
  });
  await check('uploads that stop half-way, of clients that stay and that go, hold up nobody', async () => {
    const peers = await Promise.all([1, 2, 3, 4].map(() => Peer.connect(daemon.path)));
    for (const peer of peers) {
      peer.send('HELLO', 0n, { versionMin: 1, versionMax: 1, client: 'half' });
      assert.equal((await peer.next()).type, 'WELCOME');
      peer.send('BLOOM', 1n, { input: { kind: 'INLINE', size: bytes.length } });
      peer.send('DATA', 1n, bytes.subarray(0, 1000));
    }
    const { clients } = await airy.status();
    peers.slice(0, 2).forEach((peer) => peer.socket.destroy());
    assert.ok((await airy.bloom(bytes, FAST)).output.length > 0);
    await until(async () => (await airy.status()).clients === clients - 2, 'those that went are gone');
    peers.forEach((peer) => peer.socket.destroy());
  });
  await check('close() ends what is in flight', async () => {
    const request = airy.bloom(big, FAST, { raw });
    setImmediate(() => airy.close());
    await rejects(request, { symbol: 'DISCONNECTED', retryable: false });
    await rejects(airy.bloom(bytes), { symbol: 'DISCONNECTED' });
  });
}

async function lost() {
  const { bytes } = await scene(192, 108);
  await check('a daemon that is killed: without reconnect each request hears of it', async () => {
    const daemon = await startDaemon(OPTIONS), airy = await connect({ path: daemon.path, reconnect: false });
    const all = frames(8).map(({ params }) => airy.bloom(bytes, params).then(() => 'done', (e) => e));
    daemon.child.kill('SIGKILL');
    const ends = (await Promise.all(all)).filter((e) => e !== 'done');
    assert.ok(ends.length > 0);
    for (const end of ends)
      assert.deepEqual([end.symbol, end.retryable, end.origin], ['DISCONNECTED', true, 'client'], end.stack);
    await rejects(airy.bloom(bytes), { symbol: 'DISCONNECTED' });
    airy.close();
  });
  for (const signal of ['SIGKILL', 'SIGTERM'])
    await check(`a daemon that ends by ${signal} and comes back: every frame is right`, async () => {
      let daemon = await startDaemon(OPTIONS);
      const airy = await connect({ path: daemon.path, reconnect: { forMs: 60_000, delayMsMax: 100 } });
      const wanted = [];
      for (const { params } of frames(8))
        wanted.push(digest((await airy.bloom(bytes, params)).output));
      const all = frames(8).map(({ params }) => airy.bloom(bytes, params));
      await new Promise((resolve) => setImmediate(resolve)); // they are on their way
      await stopDaemon(daemon, signal);
      const later = airy.bloom(bytes, frames(1)[0].params);
      daemon = await startDaemon(OPTIONS, daemon.path);
      assert.deepEqual((await Promise.all(all)).map((r) => digest(r.output)), wanted);
      assert.equal(digest((await later).output), wanted[0]);
      airy.close();
      await stopDaemon(daemon);
    });
  await check('a shown frame and a wall go with their daemon; the drive of it is asked again', async () => {
    let daemon = await startDaemon(OPTIONS);
    const airy = await connect({ path: daemon.path, reconnect: { forMs: 120_000 } });
    const definition = 'wall: sign\npanels:\n- {name: p, size: [8, 4]}\n', options = { raw: { width: 64, height: 32 }, wall: 'sign' };
    const frame = new Float32Array(64 * 32 * 3).fill(0.5);
    await airy.wallOpen(definition);
    assert.ok((await airy.bloom(frame, {}, options)).output.every((v) => Math.abs(v - 0.5) < 1e-4));
    daemon.child.kill('SIGSTOP'); // so that none ends before the kill
    const ends = ['shown', 'drive', 'open'].map((what) => (what === 'open' ? airy.wallOpen(definition)
      : airy.bloom(frame, {}, { ...options, show: what === 'shown' })).then(() => 'done', (e) => e.symbol));
    await new Promise((resolve) => setTimeout(resolve, 50));
    await stopDaemon(daemon, 'SIGKILL');
    daemon = await startDaemon(OPTIONS, daemon.path);
    assert.deepEqual(await Promise.all(ends), ['DISCONNECTED', 'NO_WALL', 'DISCONNECTED']);
    assert.equal((await airy.wallOpen(definition)).name, 'sign');
    airy.close();
    await stopDaemon(daemon);
  });
  await check('a frame that ends its daemon is sent four times, one that is shown once', async () => {
    let sent = 0;
    const false_ = await falseDaemon(async (peer) => {
      for (let m; (m = await peer.next());)
        if (m.type === 'BLOOM') {
          sent++;
          peer.socket.destroy();
          return;
        }
    }, { features: ['wall'] });
    const airy = await connect({ path: false_.path });
    await rejects(airy.bloom(bytes), { symbol: 'DISCONNECTED', retryable: true });
    assert.equal(sent, 4);
    await rejects(airy.bloom(bytes, {}, { wall: 'w', show: true }), { symbol: 'DISCONNECTED', retryable: true });
    assert.equal(sent, 5);
    airy.close();
    false_.close();
  });
  await check('no memory in the daemon is NO_MEMORY, and retryable; a turn that comes too late is DEADLINE', async () => {
    const daemon = await startDaemon(OPTIONS), airy = await connect({ path: daemon.path });
    const big = sparks({ width: 3840, height: 2160, type: 'PIXEL_HALF', channels: ['R', 'G', 'B'] }), raw = { width: 3840, height: 2160 };
    await airy.status();
    const size = Number(readFileSync(`/proc/${daemon.child.pid}/status`, 'utf8').match(/VmSize:\s+(\d+)/)[1]) * 1024;
    const limit = (bytes_) => run('prlimit', ['--pid', String(daemon.child.pid), `--as=${bytes_}:`]);
    await limit(size + (8 << 20));
    await rejects(airy.bloom(big, FAST, { raw }), { symbol: 'NO_MEMORY', code: 402, field: 'input.size', retryable: true, origin: 'daemon' });
    await limit('unlimited');
    const all = [1, 2, 3, 4].map(() => airy.bloom(big, FAST, { raw, priority: -5 }));
    await rejects(airy.bloom(bytes, FAST, { deadlineMs: 1, priority: -10 }), { symbol: 'DEADLINE', code: 404, field: 'deadline_ms', retryable: true });
    await Promise.all(all);
    airy.close();
    await stopDaemon(daemon);
  });
  await check('a request that waits for a daemon to come back ends with its signal', async () => {
    const daemon = await startDaemon(OPTIONS), stop = new AbortController();
    const airy = await connect({ path: daemon.path, reconnect: { attempts: 3, delayMs: 300 } });
    await stopDaemon(daemon, 'SIGKILL');
    const given = airy.bloom(bytes, FAST, { signal: stop.signal }), waiting = airy.bloom(bytes, FAST);
    let settled = false;
    waiting.catch(() => { settled = true; });
    setTimeout(() => stop.abort(), 20);
    await rejects(given, { symbol: 'CANCELLED' });
    assert.equal(settled, false);
    await rejects(waiting, { symbol: 'CONNECT', retryable: true });
    airy.close();
  });
  await check('no daemon: the error names what was tried', async () => {
    const path = socketPath();
    const error = await rejects(connect({ path }), { symbol: 'CONNECT', code: 0, field: 'socket', retryable: true });
    assert.ok(error.text.includes(path) && error.text.includes('ENOENT'));
  });
  await check('without a path, $AIRY_SOCKET comes before $XDG_RUNTIME_DIR, and one that does not answer is passed over', async () => {
    const daemon = await startDaemon(OPTIONS, join(work, 'airyd.sock'));
    const old = { ...process.env };
    try {
      process.env.XDG_RUNTIME_DIR = work;
      for (const path of [daemon.path, socketPath()]) {
        process.env.AIRY_SOCKET = path;
        const airy = await connect();
        assert.match(airy.server, /^airyd\//);
        airy.close();
      }
    } finally {
      process.env = old;
      await stopDaemon(daemon);
    }
  });
}

async function streams(daemon) {
  const airy = await connect({ path: daemon.path });
  const sizes = [[192, 108], [32, 18], [128, 72], [64, 36]];
  const files = await Promise.all(sizes.map(([w, h]) => scene(w, h).then((s) => s.bytes)));
  const many = Array.from({ length: 12 }, (_, i) => files[i % 4]);
  const wanted = [];
  for (const file of files)
    wanted.push(digest((await airy.bloom(file, FAST)).output));
  await check('a stream gives frames in order, and holds no more than its mark', async () => {
    let most = 0, out = 0, taken = 0;
    const got = [];
    await pipeline(
      Readable.from((function* () { for (const file of many) { taken++; yield file; } })(), { highWaterMark: 1 }),
      airy.stream(FAST, { highWaterMark: 3 }),
      async function (source) {
        for await (const frame of source) {
          await new Promise((resolve) => setTimeout(resolve, 10));
          most = Math.max(most, taken - ++out);
          got.push(digest(frame));
        }
      },
    );
    assert.deepEqual(got, many.map((_, i) => wanted[i % 4]));
    // Three within, and one each in hand: the generator's, Readable's and Writable's buffers of one, the reader's.
    assert.ok(most >= 2 && most <= 3 + 4, `${most} frames were taken and not given`);
  });
  await check('a bad frame costs one frame where onError says what stands for it', async () => {
    const some = [files[0], Buffer.from('no picture'), files[1], files[2]], seen = [];
    const got = [];
    const onError = (error, index, frame) => { seen.push([error.symbol, error.index, index, frame === some[1]]); };
    for await (const result of Readable.from(some).compose(airy.stream(FAST, { onError, results: true })))
      got.push(digest(result.output));
    assert.deepEqual(got, wanted.slice(0, 3));
    assert.deepEqual(seen, [['NOT_EXR', 1, 1, true]]);
  });
  await check('without onError the first bad frame ends the stream, and what is in flight', async () => {
    const some = [files[0], Buffer.from('no picture'), files[1], files[2]];
    const end = await pipeline(Readable.from(some), airy.stream(FAST), async (source) => { for await (const frame of source) void frame; })
      .then(() => 'done', (e) => e);
    assert.deepEqual([end.symbol, end.index], ['NOT_EXR', 1]);
    await until(() => airy.pending === 0, 'all have ended');
  });
  await check('a stream that nobody reads takes its mark, and stops', async () => {
    const stream = airy.stream(FAST, { highWaterMark: 2 });
    const before = (await airy.status()).done;
    for (const file of many)
      stream.write(file);
    await until(async () => (await airy.status()).done >= before + 2n && airy.pending === 0, 'two are done');
    await new Promise((resolve) => setTimeout(resolve, 50));
    assert.equal((await airy.status()).done, before + 2n);
    stream.destroy();
  });
  airy.close();
}

async function examples(daemon) {
  const { file, bytes } = await scene(192, 108), env = { ...process.env, AIRY_SOCKET: daemon.path };
  await check('the example for one frame writes what the airy command writes', async () => {
    const output = join(work, 'example.exr');
    const { stdout } = await run(process.execPath, [example('bloom-frame.mjs'), file, output, `psf=${PSF}`], { env });
    assert.match(stdout, /^beauty: 192x108, error <= /);
    assert.ok(readFileSync(output).equals(await commandBytes(daemon, file, ['--psf', PSF])));
    const damaged = join(work, 'damaged.exr');
    writeFileSync(damaged, bytes.subarray(0, 3000));
    const failed = await run(process.execPath, [example('bloom-frame.mjs'), damaged, `${output}.not`], { env }).then(() => null, (e) => e);
    assert.equal(failed.code, 1);
    assert.match(failed.stderr, /^bloom-frame: EXR_DAMAGED: /);
  });
  await check('the example for a folder blooms what is not there yet, and a bad frame costs one', async () => {
    const from = join(work, 'from'), to = join(work, 'to');
    mkdirSync(from);
    mkdirSync(to);
    for (const name of ['a.exr', 'b.exr'])
      writeFileSync(join(from, name), bytes);
    writeFileSync(join(from, 'bad.exr'), bytes.subarray(0, 3000));
    const start = () => run(process.execPath, [example('batch-folder.mjs'), from, to, `psf=${PSF}`], { env }).then((r) => ({ code: 0, ...r }), (e) => e);
    const first = await start(), wanted = await commandBytes(daemon, file, ['--psf', PSF]);
    assert.equal(first.code, 1);
    assert.match(first.stderr, /bad\.exr: EXR_DAMAGED[^]*2 of 3 frames bloomed/);
    rmSync(join(from, 'bad.exr'));
    rmSync(join(to, 'b.exr'));
    const second = await start();
    assert.equal(second.code, 0);
    assert.match(second.stderr, /1 of 1 frames bloomed/);
    assert.deepEqual(readdirSync(to).sort(), ['a.exr', 'b.exr']);
    for (const name of ['a.exr', 'b.exr'])
      assert.ok(readFileSync(join(to, name)).equals(wanted));
  });
  await check('the example for a wall feeds it', async () => {
    const definition = join(work, 'feed.yaml');
    writeFileSync(definition, 'wall: feed\npanels:\n- {name: p, size: [16, 9]}\nboards:\n- {serial: NOT-THERE, panels: p}\n');
    const { stdout } = await run(process.execPath, [example('wall-feed.mjs'), definition, '1'], { env });
    assert.match(stdout, /^feed: 144 LEDs, 60 frames\/s\n[1-9]\d* frames, [1-9]\d* shown, /);
  });
  await check('the example for HTTP blooms what is posted, and answers mistakes', async () => {
    const child = spawn(process.execPath, [example('bloom-http.mjs'), '0'], { env, stdio: ['ignore', 'pipe', 'inherit'] });
    try {
      const line = await new Promise((resolve, reject) => {
        child.stdout.once('data', (text) => resolve(String(text)));
        child.once('exit', (code) => reject(new Error(`ended with ${code}`)));
      });
      const url = line.match(/^(\S+) on airyd/)[1];
      const post = (query, body, path = '') => fetch(url + path + query, { method: 'POST', body });
      const good = await post(`?${new URLSearchParams({ psf: PSF })}`, bytes);
      assert.deepEqual([good.status, good.headers.get('content-type')], [200, 'image/x-exr']);
      const direct = await commandBytes(daemon, file, ['--psf', PSF]);
      assert.ok(Buffer.from(await good.arrayBuffer()).equals(direct));
      const bad = await post('?threshold=-99', bytes);
      assert.equal(bad.status, 422);
      assert.deepEqual((({ symbol, field }) => ({ symbol, field }))(await bad.json()), { symbol: 'PARAM_RANGE', field: 'params.threshold' });
      assert.equal((await post('', 'no picture')).status, 422);
      assert.equal((await post('', bytes, '/elsewhere')).status, 404);
    } finally {
      child.kill();
    }
  });
}

export async function live() {
  const daemon = await startDaemon(OPTIONS);
  await bytesAndNumbers(daemon);
  await inFlight(daemon);
  await streams(daemon);
  await examples(daemon);
  await stopDaemon(daemon);
  await lost();
}
