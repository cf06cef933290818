// SPDX-License-Identifier: Apache-2.0
// client.js - connect(), and what its result does: one method a question. A request is a loop around Connection.request: BUSY is asked
// again when the daemon says, and a lost connection is opened again and the request resubmitted, so many times and for so long, unless
// `reconnect` is false. Most requests of the protocol are idempotent (the same request gives the same bytes); not those that show a frame,
// or open, close or test a wall, nor one whose output has begun to flow into a Writable.
import { setTimeout as sleep } from 'node:timers/promises';
import { mayResubmit, openConnection } from './connection.js';
import { AiryAbortError, AiryError, argument } from './errors.js';
import { likeInput, toBloom, toBytes, toDrive } from './input.js';
import { BloomStream } from './stream.js';

const RETRY_MS_MAX = 10_000; // a daemon that says "in an hour" is asked again before
const RECONNECT = { forMs: 15_000, attempts: 100, delayMs: 20, delayMsMax: 1000, resubmits: 3 };
const WALL_BUSY_RETRIES = 40, WALL_RETRY_MS_MAX = 500; // a wall that is being closed is gone in a second
const PREVIEW_BYTES_MAX = 3 << 20; // a wall has at most 1 << 20 pixels

async function pause(ms, signal) {
  try {
    await sleep(ms, undefined, { signal });
  } catch {
    throw new AiryAbortError(signal.reason);
  }
}

// `promise`, or the signal's end if that comes first.
function orAborted(promise, signal) {
  if (!signal)
    return promise;
  return new Promise((resolve, reject) => {
    const stop = () => reject(new AiryAbortError(signal.reason));
    signal.addEventListener('abort', stop, { once: true });
    promise.then(resolve, reject).finally(() => signal.removeEventListener('abort', stop));
  });
}

function socketPaths(path) {
  if (path)
    return [path];
  const { AIRY_SOCKET, XDG_RUNTIME_DIR } = process.env;
  return [AIRY_SOCKET, XDG_RUNTIME_DIR && `${XDG_RUNTIME_DIR}/airyd.sock`, '/run/airyd/airyd.sock'].filter(Boolean);
}

async function openAny(options) {
  const tried = [], end = performance.now() + options.timeoutMs;
  for (const path of socketPaths(options.path))
    try {
      return await openConnection({ path, client: options.client, timeoutMs: Math.max(1, end - performance.now()) });
    } catch (error) {
      // A daemon that is there and refuses has answered.
      if (error.symbol !== 'CONNECT')
        throw error;
      tried.push(error);
    }
  throw tried.length === 1 ? tried[0] : new AiryError('CONNECT', `no daemon answers (${tried.map((e) => e.text).join('; ')})`,
    { field: 'socket', retryable: true, cause: tried[0] });
}

const TOTALS = ['input', 'bright', 'bloomed', 'lost', 'clamped', 'suppressed'];

function resultOf(reply, output, size) {
  const { targets, ms, notes, device, chunks, chunksCopied, exposure, need, stamp } = reply;
  const energy = Object.fromEntries(TOTALS.map((name) => [name, targets.reduce((sum, t) => sum + (t.energy?.[name] ?? 0), 0)]));
  const bound = targets.reduce((most, t) => Math.max(most, t.errorBound), 0);
  return { output, size, targets, energy, bound, ms, notes, device, chunks, chunksCopied, exposure, need, stamp };
}

// Of a frame that is done again the second way through is not told twice.
function neverFalling(onProgress) {
  let least = 0;
  return onProgress && ((progress) => {
    if (progress.fraction >= least) {
      least = progress.fraction;
      onProgress(progress);
    }
  });
}

const wrong = (field, text) => new AiryError('BAD_BODY', `from the daemon: ${text}`, { field });

function oneWall({ walls }) {
  if (walls.length !== 1)
    throw wrong('walls', `${walls.length} walls came, expected the one that was named`);
  return walls[0];
}

export class Airy {
  #options;
  #connection;
  #opening = null;
  #closed = false;

  constructor(options, connection) {
    this.#options = options;
    this.#connection = connection;
  }

  get server() { return this.#connection.welcome.server; }
  get device() { return this.#connection.welcome.device; }
  get features() { return this.#connection.welcome.features; }
  get limits() { return this.#connection.welcome.limits; }
  get looks() { return this.#connection.welcome.looks; }
  /** Requests that have not ended, those cancelled included. */
  get pending() { return this.#connection.pending; }

  async bloom(input, params, options = {}) {
    const { signal, onProgress, into, ...rest } = options;
    this.#knows({ wall: rest.wall, priority: rest.priority, deadline: rest.deadlineMs });
    const request = { ...toBloom(input, params, { ...rest, progress: Boolean(onProgress), plan: false }), into, signal,
      onProgress: neverFalling(onProgress) };
    if (rest.wall && !rest.show && !into)
      return this.#drive(request, rest.wall);
    const { reply, output, size } = await this.#ask(signal, (c) => c.request(request));
    return resultOf(reply, request.output ? likeInput(input, output) : null, size ?? 0);
  }

  // A drive is as large as its wall, which its RESULT does not say; the list comes before that.
  async #drive(request, name) {
    const { reply, output, size, listed } = await this.#ask(request.signal, async (c) => {
      const asked = c.ask({ type: 'WALL', answer: 'WALL_REPLY', body: { action: 'LIST', name } });
      asked.catch(() => {}); // then the request fails, too, and better
      const done = await c.request(request);
      return { ...done, listed: (await asked).reply };
    });
    const { width, height } = oneWall(listed);
    if (size !== width * height * 12)
      throw new AiryError('PAYLOAD', `the drive of a wall of ${width} x ${height} is ${size} bytes, expected ${width * height * 12}`,
        { field: 'output.size' });
    return { ...resultOf(reply, toDrive(output), size), width, height };
  }

  async plan(input, params, options = {}) {
    const { signal, exr, raw, wall, partOf } = options;
    this.#knows({ wall });
    const request = toBloom(input, params, { exr, raw, wall, partOf, progress: false, plan: true });
    const { reply } = await this.#ask(signal, (c) => c.request({ ...request, signal }));
    return resultOf(reply, null, 0);
  }

  async asset(input, { signal } = {}) {
    const bytes = toBytes(input, 'input');
    const request = { type: 'ASSET', input: bytes, output: false, body: { input: { kind: 'INLINE', size: bytes.byteLength } } };
    const { reply } = await this.#ask(signal, (c) => c.request({ ...request, signal }));
    if (!/^[0-9a-f]{32}$/.test(reply.digest))
      throw new AiryError('BAD_BODY', `from the daemon: digest is "${reply.digest.slice(0, 64)}", expected 32 hexadecimal digits`,
        { field: 'digest' });
    return reply;
  }

  async status({ signal } = {}) {
    return (await this.#ask(signal, (c) => c.ask({ type: 'STATUS', body: null, answer: 'STATUS_REPLY', signal }))).reply;
  }

  async wallList(name = '', { signal } = {}) {
    const { reply } = await this.#wall({ action: 'LIST', name }, { signal });
    const { walls, controllers, usb } = reply;
    return { walls, controllers, usb };
  }

  async wallOpen(definition, { calibration, keep, signal } = {}) {
    const { reply } = await this.#wall({ action: 'OPEN', definition, calibration, keep }, { signal, once: true });
    return oneWall(reply);
  }

  async wallClose(name, { signal } = {}) {
    await this.#wall({ action: 'CLOSE', name }, { signal, once: true });
  }

  async wallPattern(name, pattern = '', { board, led, level, signal } = {}) {
    const { reply } = await this.#wall({ action: 'PATTERN', name, pattern, board, led, level }, { signal, once: true });
    return oneWall(reply);
  }

  async wallPreview(name, { signal } = {}) {
    const { reply, data } = await this.#wall({ action: 'PREVIEW', name }, { signal, dataMax: PREVIEW_BYTES_MAX });
    const wall = oneWall(reply), want = wall.width * wall.height * 3, { kind = 'NONE', size = 0n } = reply.preview ?? {};
    if (kind !== 'INLINE' || size !== BigInt(data.length) || data.length !== want)
      throw wrong('preview.size', `a preview of ${want} bytes is said to be ${kind} of ${size}, ${data.length} came`);
    return { wall, width: wall.width, height: wall.height, data };
  }

  stream(params, options) {
    return new BloomStream(this, params, options);
  }

  close() {
    this.#closed = true;
    this.#connection.close();
  }

  #knows(asked) {
    for (const [feature, given] of Object.entries(asked))
      if (given && !this.features.includes(feature))
        throw argument(feature, `${this.server} does not know ${feature}`);
  }

  #wall(body, { signal, once, dataMax }) {
    this.#knows({ wall: true });
    return this.#ask(signal, (c) => c.ask({ type: 'WALL', answer: 'WALL_REPLY', body, signal, once, dataMax }),
      { busyRetries: WALL_BUSY_RETRIES, retryMsMax: WALL_RETRY_MS_MAX });
  }

  async #ask(signal, send, { busyRetries = this.#options.busyRetries, retryMsMax = RETRY_MS_MAX } = {}) {
    const { reconnect } = this.#options;
    for (let busy = 0, lost = 0, end = null; ;) {
      const connection = await this.#live(signal);
      try {
        return await send(connection);
      } catch (error) {
        if (error.symbol === 'BUSY' && error.origin === 'daemon' && busy++ < busyRetries) {
          await pause(Math.min(Math.max(error.retryAfterMs, 1), retryMsMax), signal);
          continue;
        }
        if (!reconnect || this.#closed || !mayResubmit.has(error))
          throw error;
        // A daemon that stops has refused it without trying: that is not one of the few times, but it has its time.
        const refused = error.symbol === 'SHUTTING_DOWN';
        end ??= performance.now() + reconnect.forMs;
        if (refused ? performance.now() >= end : lost++ >= reconnect.resubmits)
          throw error;
        connection.retired = true;
        if (refused)
          await pause(reconnect.delayMs, signal);
        else
          end = null;
      }
    }
  }

  // The connection, opened again when it must be: once for all who wait.
  async #live(signal) {
    if (this.#closed)
      throw new AiryError('DISCONNECTED', 'the connection was closed by this side');
    if (signal?.aborted)
      throw new AiryAbortError(signal.reason);
    if (this.#connection.alive || !this.#options.reconnect)
      return this.#connection;
    this.#opening ??= this.#reopen().finally(() => { this.#opening = null; });
    await orAborted(this.#opening, signal);
    return this.#live(signal);
  }

  async #reopen() {
    const { attempts, delayMs, delayMsMax, forMs } = this.#options.reconnect, end = performance.now() + forMs;
    for (let n = 0; ; n++)
      try {
        const next = await openAny(this.#options);
        // What is still in flight on a daemon that is stopping ends there by itself.
        this.#connection = next;
        if (this.#closed)
          next.close();
        return;
      } catch (error) {
        if (!error.retryable || n + 1 >= attempts || this.#closed || performance.now() >= end)
          throw error;
        await sleep(Math.min(delayMs * 2 ** n, delayMsMax, Math.max(1, end - performance.now())));
      }
  }
}

export async function connect(options = {}) {
  const { path, reconnect = true, busyRetries = 20, timeoutMs = 30_000, client = 'airy-node/0.1.0' } = options;
  if (!Number.isInteger(busyRetries) || busyRetries < 0)
    throw argument('busyRetries', `busyRetries is ${busyRetries}, expected a whole number from 0`);
  if (!(timeoutMs > 0 && timeoutMs <= 2 ** 31 - 1))
    throw argument('timeoutMs', `timeoutMs is ${timeoutMs}, expected 1 to 2^31 - 1`);
  const all = { path, busyRetries, timeoutMs, client, reconnect: reconnect && { ...RECONNECT, ...(reconnect === true ? {} : reconnect) } };
  return new Airy(all, await openAny(all));
}
