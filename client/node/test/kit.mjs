// SPDX-License-Identifier: Apache-2.0
// kit.mjs - what the tests share: TAP lines, real daemons, pictures, the other end of a socket (a bare client to a real daemon, and a
// daemon that misbehaves, which no real one does), protobuf's JSON mapping.
import assert from 'node:assert/strict';
import { execFile, spawn } from 'node:child_process';
import { mkdtempSync, readFileSync, rmSync } from 'node:fs';
import net from 'node:net';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { promisify } from 'node:util';
import { schema } from '../gen/contract.js';
import { connect } from '../lib/index.js';
import { bodyName, encodeHeader, FrameReader } from '../lib/frame.js';
import { decode, encode } from '../lib/protobuf.js';

export const { AIRY_ROOT: root, AIRY: airyCommand, AIRYD: airyd, SCENE: sceneMaker } = process.env;
export const work = mkdtempSync(join(tmpdir(), 'airy-node-'));
export const run = promisify(execFile);
const STEP_MS = 300_000;

// ---- TAP ----------------------------------------------------------------------------------------

let count = 0, failures = 0;

function report(ok, name, more = '') {
  process.stdout.write(`${ok ? 'ok' : 'not ok'} ${++count} - ${name.replaceAll('#', '\\#')}${more}\n`);
}

/** One line of TAP. A test that hangs has failed. */
export async function check(name, body) {
  let timer;
  const late = new Promise((_, reject) => { timer = setTimeout(() => reject(new Error(`not done in ${STEP_MS} ms`)), STEP_MS); });
  try {
    await Promise.race([body(), late]);
    report(true, name);
  } catch (error) {
    failures++;
    report(false, name);
    process.stdout.write(`${(error.stack ?? String(error)).split('\n').slice(0, 12).map((l) => `# ${l.slice(0, 300)}`).join('\n')}\n`);
  } finally {
    clearTimeout(timer);
  }
}

export const skip = (name, reason) => report(true, name, ` # SKIP ${reason}`);

/** The plan and the clean-up, at the end: how many tests there are is known then. */
export async function finish() {
  for (const daemon of daemons)
    daemon.child.kill('SIGKILL');
  rmSync(work, { recursive: true, force: true });
  process.stdout.write(`1..${count}\n`);
  process.exit(failures ? 1 : 0);
}

/** Waits until `what()` holds. */
export async function until(what, name) {
  const end = performance.now() + STEP_MS;
  while (!await what()) {
    if (performance.now() > end)
      throw new Error(`${name}: not within ${STEP_MS} ms`);
    await new Promise((resolve) => setTimeout(resolve, 5));
  }
}

/** Rejects with an AiryError that has these properties. */
export async function rejects(promise, wanted) {
  const error = await promise.then(() => assert.fail(`resolved, expected ${JSON.stringify(wanted)}`), (e) => e);
  assert.equal(error.constructor.name, wanted.symbol === 'CANCELLED' ? 'AiryAbortError' : 'AiryError', error.stack);
  for (const [key, value] of Object.entries(wanted))
    key === 'text' && wanted.symbol === 'WALL' ? assert.ok(error.text.startsWith(value), error.stack) : assert.deepEqual(error[key], value, `${key} of ${error.stack}`);
  assert.ok(error.text.length > 0, 'the error has a text');
  return error;
}

// ---- daemons ----------------------------------------------------------------------------------------

const daemons = [];
let sockets = 0;
export const socketPath = () => join(work, `${++sockets}.sock`);

export async function startDaemon(options, path = socketPath()) {
  const child = spawn(airyd, ['--socket', path, ...options], { stdio: ['ignore', 'ignore', 'pipe'] });
  const daemon = { child, path, said: '', ended: new Promise((resolve) => child.once('exit', resolve)) };
  child.stderr.on('data', (text) => { daemon.said += text; });
  daemons.push(daemon);
  let dead = null;
  daemon.ended.then((code) => { dead = code ?? 'a signal'; });
  await until(async () => {
    if (dead !== null)
      throw new Error(`airyd ended with ${dead}: ${daemon.said}`);
    return connect({ path }).then((airy) => { airy.close(); return true; }, () => false);
  }, 'airyd answers');
  return daemon;
}

export async function stopDaemon(daemon, signal) {
  daemon.child.kill(signal);
  await daemon.ended;
}

// ---- pictures -----------------------------------------------------------------------------------------

const scenes = new Map();
export async function scene(width, height) {
  const name = `${width}x${height}`;
  if (!scenes.has(name)) {
    const file = join(work, `${name}.exr`);
    await run(sceneMaker, [file, String(width), String(height)]);
    scenes.set(name, { file, bytes: readFileSync(file) });
  }
  return scenes.get(name);
}

let outputs = 0;
/** The bytes that the airy command writes, from the same daemon. */
export async function commandBytes(daemon, input, options) {
  const output = join(work, `command-${++outputs}.exr`);
  await run(airyCommand, ['bloom', input, output, '--socket', daemon.path, ...options]);
  return readFileSync(output);
}

/** Interleaved samples with sparks, as tests/conformance/README.md has them. */
export function sparks({ width, height, type, channels, fill }) {
  const half = type === 'PIXEL_HALF', n = channels.length;
  const values = half ? { spark: 0x5000, dim: 0x3000, one: 0x3c00 } : { spark: 32, dim: 0.125, one: 1 };
  const out = half ? new Uint16Array(width * height * n) : new Float32Array(width * height * n);
  if (fill !== undefined)
    return out.fill(fill);
  for (let y = 0, at = 0; y < height; y++)
    for (let x = 0; x < width; x++) {
      const value = (7 * x + 13 * y) % 61 === 0 ? values.spark : values.dim;
      for (let c = 0; c < n; c++)
        out[at++] = channels[c] === 'A' ? values.one : value;
    }
  return out;
}

export function halfToNumber(h) {
  const exponent = (h >> 10) & 31, fraction = h & 1023, sign = h & 0x8000 ? -1 : 1;
  return sign * (exponent ? (1 + fraction / 1024) * 2 ** (exponent - 15) : fraction * 2 ** -24);
}

// ---- the other end of a socket -----------------------------------------------------------------------------

/** One end that sends what it is told to and keeps what comes: `sender` is who talks to it. */
export class Peer {
  #arrived = [];
  #waiting = [];
  #closed = false;
  received = [];
  ended = false;

  constructor(socket, sender) {
    this.socket = socket;
    const reader = new FrameReader(sender, {
      header: () => {},
      data: (h, piece) => { h.data = Buffer.concat([h.data ?? Buffer.alloc(0), piece]); },
      message: (h, bytes) => {
        const name = bodyName(h.type);
        this.#add({ ...h, body: schema.messages[name] ? decode(schema, name, bytes) : {}, bytes });
      },
    });
    socket.on('data', (chunk) => reader.push(chunk));
    socket.on('error', () => {});
    socket.on('close', () => { this.#closed = true; this.#wake(); });
    socket.on('end', () => { this.ended = true; this.#closed = true; this.#wake(); });
  }

  static connect(path) {
    return new Promise((resolve, reject) => {
      const socket = net.connect({ path }, () => resolve(new Peer(socket, 'daemon')));
      socket.once('error', reject);
    });
  }

  #add(message) {
    this.received.push(message);
    this.#arrived.push(message);
    this.#wake();
  }

  #wake() {
    this.#waiting.splice(0).forEach((wake) => wake());
  }

  send(type, id = 0n, body = null, nFds = 0) {
    const bytes = Buffer.isBuffer(body) ? body : body ? encode(schema, bodyName(type), body) : Buffer.alloc(0);
    this.socket.write(Buffer.concat([encodeHeader(type, id, bytes.length, nFds), bytes]));
  }

  /** The next message that is none of `passing`; null at the end of the stream. */
  async next(passing = []) {
    const end = performance.now() + STEP_MS;
    for (;;) {
      while (this.#arrived.length) {
        const message = this.#arrived.shift();
        if (!passing.includes(message.type))
          return message;
      }
      if (this.#closed)
        return null;
      if (performance.now() > end)
        throw new Error(`no message in ${STEP_MS} ms`);
      await Promise.race([new Promise((wake) => this.#waiting.push(wake)), new Promise((r) => setTimeout(r, STEP_MS).unref())]);
    }
  }
}

export const LIMITS = { maxFrameBytes: 1 << 20, maxWidth: 4096, maxHeight: 4096, maxPixels: 1 << 24, creditBytes: 1 << 20, maxRequests: 4,
  maxBodyBytes: 1 << 20 };

/** A daemon's end in the test's hands: serve(peer) is called for each client, after WELCOME unless `greet` is false. */
export async function falseDaemon(serve, { greet = true, limits = LIMITS, features = [] } = {}) {
  const path = socketPath();
  const server = net.createServer(async (socket) => {
    const peer = new Peer(socket, 'client');
    if (greet) {
      await peer.next();
      peer.send('WELCOME', 0n, { version: 1, server: 'false/1', features, limits });
    }
    await serve(peer);
  });
  await new Promise((resolve) => server.listen(path, resolve));
  server.unref();
  return { path, close: () => server.close() };
}

// ---- protobuf's JSON mapping -----------------------------------------------------------------------------------

/** The fields that are not at their default, 64-bit numbers as text: how vectors and cases write a body. */
export function toJson(name, body) {
  const out = {};
  for (const f of schema.messages[name]) {
    const value = body[f.name];
    const one = (v) => (f.type === 'message' ? toJson(f.of, v) : typeof v === 'bigint' ? String(v) : v);
    if (f.repeated ? value.length : f.oneof ? value !== undefined : f.type === 'message' ? value !== null
      : value !== 0 && value !== 0n && value !== '' && value !== false && !(f.type === 'enum' && schema.enums[f.of][value] === 0))
      out[f.name] = f.repeated ? value.map(one) : one(value);
  }
  return out;
}
