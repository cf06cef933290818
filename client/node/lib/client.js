// SPDX-License-Identifier: Apache-2.0
// client.js - connect(), and what its result does: one method a question. A request is a loop around Connection.request: BUSY is asked
// again when the daemon says, and, where `reconnect` was asked for, a lost connection is opened again and the request resubmitted. All
// requests of the protocol are idempotent (the same request gives the same bytes), but for one whose output has begun to flow into a
// Writable.
import { setTimeout as sleep } from 'node:timers/promises';
import { mayResubmit, openConnection } from './connection.js';
import { AiryAbortError, AiryError, argument } from './errors.js';
import { likeInput, toBloom, toBytes } from './input.js';
import { BloomStream } from './stream.js';

const RETRY_MS_MAX = 10_000; // a daemon that says "in an hour" is asked again before
const RECONNECT = { attempts: 10, delayMs: 50, delayMsMax: 2000, resubmits: 3 };

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
  const { targets, ms, notes, device, chunks, chunksCopied, exposure } = reply;
  const energy = Object.fromEntries(TOTALS.map((name) => [name, targets.reduce((sum, t) => sum + (t.energy?.[name] ?? 0), 0)]));
  const bound = targets.reduce((most, t) => Math.max(most, t.errorBound), 0);
  return { output, size, targets, energy, bound, ms, notes, device, chunks, chunksCopied, exposure };
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
    const { signal, onProgress, into, exr, raw } = options;
    const request = toBloom(input, params, { exr, raw, progress: Boolean(onProgress), plan: false });
    const { reply, output, size } = await this.#ask(signal, (c) => c.request({ ...request, into, onProgress, signal }));
    return resultOf(reply, likeInput(input, output), size);
  }

  async plan(input, params, options = {}) {
    const { signal, exr, raw } = options;
    const request = toBloom(input, params, { exr, raw, progress: false, plan: true });
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

  status({ signal } = {}) {
    return this.#ask(signal, (c) => c.status({ signal }));
  }

  stream(params, options) {
    return new BloomStream(this, params, options);
  }

  close() {
    this.#closed = true;
    this.#connection.close();
  }

  async #ask(signal, send) {
    const { reconnect, busyRetries } = this.#options;
    for (let busy = 0, lost = 0; ;) {
      const connection = await this.#live(signal);
      try {
        return await send(connection);
      } catch (error) {
        if (error.symbol === 'BUSY' && error.origin === 'daemon' && busy++ < busyRetries) {
          await pause(Math.min(Math.max(error.retryAfterMs, 1), RETRY_MS_MAX), signal);
          continue;
        }
        const again = mayResubmit.has(error) || error.symbol === 'SHUTTING_DOWN';
        if (!reconnect || this.#closed || !again || lost++ >= reconnect.resubmits)
          throw error;
        connection.retired = true;
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
    const { attempts, delayMs, delayMsMax } = this.#options.reconnect;
    for (let n = 0; ; n++)
      try {
        const next = await openAny(this.#options);
        // What is still in flight on a daemon that is stopping ends there by itself.
        this.#connection = next;
        if (this.#closed)
          next.close();
        return;
      } catch (error) {
        if (!error.retryable || n + 1 >= attempts || this.#closed)
          throw error;
        await sleep(Math.min(delayMs * 2 ** n, delayMsMax));
      }
  }
}

export async function connect(options = {}) {
  const { path, reconnect = false, busyRetries = 20, timeoutMs = 5000, client = 'airy-node/0.1.0' } = options;
  if (!Number.isInteger(busyRetries) || busyRetries < 0)
    throw argument('busyRetries', `busyRetries is ${busyRetries}, expected a whole number from 0`);
  if (!(timeoutMs > 0 && timeoutMs <= 2 ** 31 - 1))
    throw argument('timeoutMs', `timeoutMs is ${timeoutMs}, expected 1 to 2^31 - 1`);
  const all = { path, busyRetries, timeoutMs, client, reconnect: reconnect && { ...RECONNECT, ...(reconnect === true ? {} : reconnect) } };
  return new Airy(all, await openAny(all));
}
