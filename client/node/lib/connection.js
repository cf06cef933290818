// SPDX-License-Identifier: Apache-2.0
// connection.js - one connection to a daemon: HELLO, requests under its credits and limits, and whatever it sends, checked.
//
// One request is submitted, uploaded, answered and forgotten here; retries and reconnecting are client.js's. Invariants: a request is in
// #waiting or in #open until its end; DATA goes up one message at a time, of the oldest request first, and only when the socket has taken
// the one before, so that a CANCEL or STATUS waits for at most 1 MiB; whatever the daemon sends and may not, ends the connection with the
// contract's symbol.
import net from 'node:net';
import { schema } from '../gen/contract.js';
import { AiryAbortError, AiryError, closes, fromDaemon } from './errors.js';
import { BODY_BYTES_MAX, bodyName, DATA_BYTES_MAX, encodeHeader, FrameError, FrameReader } from './frame.js';
import { BodyError, decode, encode } from './protobuf.js';
import { makeSink } from './sink.js';

/** Errors whose request can be asked again of another daemon: it was refused by one that stops, or its connection was lost, it gives the
 same however often it is asked or was not sent yet, and none of its output has been handed on. */
export const mayResubmit = new WeakSet();

const ANSWERS = ['STATUS_REPLY', 'WALL_REPLY'];
const END = { BLOOM: 'RESULT', ASSET: 'ASSET_KEPT' };

/** Opens, greets and is welcomed, or rejects; all within timeoutMs. */
export function openConnection({ path, timeoutMs, client }) {
  return new Promise((resolve, reject) => {
    const socket = net.connect({ path });
    const timer = setTimeout(() => socket.destroy(new AiryError('CONNECT', `${path}: no WELCOME within ${timeoutMs} ms`,
      { field: 'socket', retryable: true })), timeoutMs);
    const connection = new Connection(socket, path, client, (error) => {
      clearTimeout(timer);
      error ? reject(error) : resolve(connection);
    });
  });
}

export class Connection {
  #socket;
  #path;
  #greeted; // told once: of WELCOME, or of the reason why there is none
  #reader;
  #welcome = null;
  #lost = null; // why the connection is gone
  #credit = 0;
  #maxCredit = 0;
  #maxFrame = 0;
  #maxData = DATA_BYTES_MAX;
  #nextId = 1n;
  #waiting = []; // not sent: no credit, or too many open
  #open = new Map(); // sent, and not ended
  #uploads = []; // of those, with DATA left
  #asked = new Map(); // questions: STATUS, WALL
  #holds = 0; // who wants the socket not to be read
  /** Another should be opened for what comes next. */
  retired = false;

  constructor(socket, path, client, greeted) {
    this.#socket = socket;
    this.#path = path;
    this.#greeted = greeted;
    this.#reader = new FrameReader('daemon', {
      header: (h) => this.#onHeader(h),
      data: (h, piece) => this.#onData(h, piece),
      message: (h, body) => this.#onMessage(h, body),
    });
    socket.once('connect', () => this.#send('HELLO', 0n, { versionMin: 1, versionMax: 1, client }));
    socket.on('data', (chunk) => this.#onChunk(chunk));
    socket.on('drain', () => this.#upload());
    socket.once('end', () => this.#lose(this.#gone('the daemon closed the connection')));
    socket.on('error', (error) => this.#lose(error instanceof AiryError ? error : this.#gone(error.message, error)));
    socket.once('close', () => this.#lose(this.#gone('the connection was closed')));
  }

  get welcome() {
    return this.#welcome;
  }

  get alive() {
    return !this.#lost && !this.retired;
  }

  /** Requests that have not ended, for who wants to know whether the connection is idle. */
  get pending() {
    return this.#waiting.length + this.#open.size;
  }

  close() {
    this.#lose(new AiryError('DISCONNECTED', 'the connection was closed by this side'));
  }

  /**
   * One request: { type: BLOOM or ASSET, body, input, output, into, expectBytes, onProgress, signal, once }; `output` tells whether DATA may
   * come, `once` that it is not asked again when it was sent.
   * Resolves with { reply, output, size }, or rejects with an AiryError; those in mayResubmit can be asked again.
   */
  request(wanted) {
    return new Promise((resolve, reject) => {
      const request = { ...wanted, size: wanted.input.byteLength, sent: 0, got: 0, settled: false, sink: null };
      const { signal } = request;
      const onAbort = () => this.#abort(request, new AiryAbortError(signal.reason));
      request.settle = (error, value) => {
        if (request.settled)
          return;
        request.settled = true;
        signal?.removeEventListener('abort', onAbort);
        request.sink?.release();
        error ? reject(error) : resolve(value);
      };
      if (signal?.aborted)
        return request.settle(new AiryAbortError(signal.reason));
      if (this.#lost)
        return request.settle(this.#again(this.#lost, request));
      if (request.size > this.#maxFrame)
        return request.settle(new AiryError('LIMIT', `input.size is ${request.size}, expected at most ${this.#maxFrame} bytes`,
          { field: 'input.size' }));
      try {
        request.bytes = this.#encode(request.type, request.body);
      } catch (error) {
        return request.settle(error);
      }
      if (request.output)
        request.sink = makeSink(request, this.#maxFrame, {
          hold: () => this.#hold(1),
          release: () => this.#hold(-1),
          fail: (error) => this.#abort(request, error),
        });
      signal?.addEventListener('abort', onAbort, { once: true });
      this.#waiting.push(request);
      this.#admit();
    });
  }

  /**
   * One question: { type: STATUS or WALL, body, answer, dataMax, signal, once }, answered beside whatever is in flight. Resolves with
   * { reply, data }: DATA, of at most dataMax bytes, may come before the answer.
   */
  ask({ type, body, answer, dataMax = 0, signal, once = false }) {
    return new Promise((resolve, reject) => {
      if (signal?.aborted)
        return reject(new AiryAbortError(signal.reason));
      if (this.#lost)
        return reject(this.#again(this.#lost, { once: false }));
      let bytes;
      try {
        bytes = this.#encode(type, body);
      } catch (error) {
        return reject(error);
      }
      const id = this.#nextId++;
      // Its answer is still taken when nobody waits for it any more.
      const onAbort = () => reject(new AiryAbortError(signal.reason));
      signal?.addEventListener('abort', onAbort, { once: true });
      const done = (settle) => (value) => {
        signal?.removeEventListener('abort', onAbort);
        settle(value);
      };
      this.#asked.set(id, { id, answer, dataMax, once, got: 0, pieces: [], resolve: done(resolve), reject: done(reject) });
      this.#write(type, id, bytes);
    });
  }

  // ---- sending ------------------------------------------------------------------------------------

  #encode(type, body) {
    let bytes;
    try {
      bytes = body ? encode(schema, bodyName(type), body, '') : Buffer.alloc(0);
    } catch (error) {
      if (error instanceof BodyError)
        throw new AiryError('ARGUMENT', error.message.replaceAll(/(^| )\./g, '$1'), { field: error.field.replace(/^\./, '') });
      throw error;
    }
    if (bytes.length > BODY_BYTES_MAX)
      throw new AiryError('TOO_LONG', `${type} has a body of ${bytes.length} bytes, expected at most ${BODY_BYTES_MAX}`);
    return bytes;
  }

  #write(type, id, bytes) {
    this.#socket.cork();
    this.#socket.write(encodeHeader(type, id, bytes.byteLength));
    if (bytes.byteLength)
      this.#socket.write(bytes);
    this.#socket.uncork();
  }

  #send(type, id, body) {
    this.#write(type, id, this.#encode(type, body));
  }

  // In the order of their coming: a large frame is not overtaken for ever by small ones.
  #admit() {
    while (this.#waiting.length && !this.#lost) {
      const request = this.#waiting[0];
      if (request.size > this.#credit || this.#open.size >= this.#welcome.limits.maxRequests)
        break;
      this.#waiting.shift();
      request.id = this.#nextId++;
      this.#credit -= request.size;
      this.#open.set(request.id, request);
      this.#write(request.type, request.id, request.bytes);
      request.bytes = null;
      if (request.size)
        this.#uploads.push(request);
    }
    this.#upload();
  }

  #upload() {
    while (this.#uploads.length && !this.#lost && !this.#socket.writableNeedDrain) {
      const request = this.#uploads[0];
      if (!request.settled) {
        const piece = request.input.subarray(request.sent, request.sent + this.#maxData);
        request.sent += piece.byteLength;
        this.#write('DATA', request.id, piece);
      }
      if (request.settled || request.sent === request.size) {
        request.input = null;
        this.#uploads.shift();
      }
    }
  }

  // The caller hears at once; the daemon's last message for it is waited for in silence.
  #abort(request, error) {
    if (request.settled)
      return;
    const at = this.#waiting.indexOf(request);
    if (at >= 0)
      this.#waiting.splice(at, 1);
    request.settle(error);
    if (at < 0 && !this.#lost)
      this.#send('CANCEL', request.id, null);
    this.#admit();
  }

  // ---- receiving ------------------------------------------------------------------------------------

  #hold(more) {
    this.#holds += more;
    this.#holds ? this.#socket.pause() : this.#socket.resume();
  }

  #onChunk(chunk) {
    if (this.#lost)
      return;
    try {
      this.#reader.push(chunk);
    } catch (error) {
      const ours = error instanceof FrameError || error instanceof BodyError;
      this.#lose(ours ? new AiryError(error.symbol ?? 'BAD_BODY', `from the daemon: ${error.message}`, { field: error.field }) : error);
    }
    this.#admit();
  }

  #refuse(h, why) {
    throw new FrameError('UNEXPECTED', 'header.type', `${h.type} for id ${h.id} may not come${why}`);
  }

  #onHeader(h) {
    if (h.nFds)
      throw new FrameError('BAD_FDS', 'header.n_fds', `header.n_fds of ${h.type} is ${h.nFds}, expected 0: no descriptor was asked for`);
    if (h.type === 'ERROR')
      return;
    if (!this.#welcome !== (h.type === 'WELCOME'))
      this.#refuse(h, this.#welcome ? ' twice' : ' before WELCOME');
    const request = this.#open.get(h.id), question = this.#asked.get(h.id);
    if (h.type === 'DATA' && question?.dataMax) {
      if (question.got + h.bodyBytes > question.dataMax)
        throw new FrameError('PAYLOAD', 'preview.size', `the answer to question ${h.id} has more than ${question.dataMax} bytes of DATA`);
    } else if (h.type === 'DATA') {
      if (!request?.output)
        this.#refuse(h, ': no open request has output');
      const most = request.expectBytes ?? this.#maxFrame;
      if (request.got + h.bodyBytes > most)
        throw new FrameError('PAYLOAD', 'output.size', `the output of request ${h.id} is more than the ${most} bytes that it can be`);
    } else if (Object.values(END).includes(h.type) && h.type !== END[request?.type])
      this.#refuse(h, ': no open request ends so');
    else if (h.type === 'CANCELLED' && !request?.settled)
      this.#refuse(h, ': no open request was cancelled');
    else if (ANSWERS.includes(h.type) && question?.answer !== h.type)
      this.#refuse(h, ': no question is open that it answers');
  }

  #onData(h, piece) {
    const question = this.#asked.get(h.id);
    if (question) {
      question.got += piece.length;
      question.pieces.push(Buffer.from(piece));
      return;
    }
    const request = this.#open.get(h.id);
    request.got += piece.length;
    if (!request.settled)
      request.sink.take(piece);
  }

  #onMessage(h, bytes) {
    if (h.type === 'DATA')
      return;
    const known = schema.messages[bodyName(h.type)];
    if (!known && bytes.length)
      throw new FrameError('BAD_BODY', 'header.body_bytes', `${h.type} has a body of ${bytes.length} bytes, expected none`);
    const body = known ? decode(schema, bodyName(h.type), bytes) : null;
    const request = this.#open.get(h.id);
    switch (h.type) {
      case 'WELCOME': return this.#onWelcome(body);
      case 'CREDIT': return this.#onCredit(body);
      case 'ERROR': return this.#onError(h, body, request);
      case 'STATUS_REPLY':
      case 'WALL_REPLY': {
        const question = this.#asked.get(h.id);
        this.#asked.delete(h.id);
        return question.resolve({ reply: body, data: Buffer.concat(question.pieces) });
      }
      case 'PROGRESS':
        if (request && !request.settled && request.onProgress)
          this.#tell(request, body);
        return;
      case 'RESULT':
      case 'ASSET_KEPT': return this.#onEnd(h, body, request);
      case 'CANCELLED':
        this.#open.delete(h.id);
        return;
      default: // the contract knows it, and this client has not asked for it
        this.#refuse(h, ' here');
    }
  }

  #onWelcome(body) {
    const { version, limits } = body;
    if (version !== 1)
      throw new FrameError('BAD_VERSION', 'version', `version is ${version}, expected 1`);
    for (const field of schema.messages.Limits) {
      const value = limits?.[field.name];
      if (!value || value > Number.MAX_SAFE_INTEGER)
        throw new FrameError('BAD_BODY', `limits.${field.name}`, `limits.${field.name} is ${value ?? 'absent'}, expected 1 to 2^53 - 1`);
    }
    this.#maxFrame = Number(limits.maxFrameBytes);
    this.#maxData = Math.min(DATA_BYTES_MAX, limits.maxBodyBytes);
    this.#credit = this.#maxCredit = Number(limits.creditBytes);
    if (this.#credit < this.#maxFrame)
      throw new FrameError('BAD_BODY', 'limits.creditBytes', `limits.creditBytes is ${this.#credit}, expected at least ${this.#maxFrame}`);
    this.#welcome = body;
    this.#greeted(null);
  }

  #onCredit({ bytes }) {
    if (bytes > BigInt(this.#maxCredit - this.#credit))
      throw new FrameError('BAD_BODY', 'credit.bytes', `credit.bytes is ${bytes}, expected at most the ${
        this.#maxCredit - this.#credit} that are out`);
    this.#credit += Number(bytes);
  }

  #onError(h, body, request) {
    const error = fromDaemon(body), last = h.id === 0n || closes(body.code), question = this.#asked.get(h.id);
    if (!request && !question && !last)
      this.#refuse(h, ': no such request is open');
    if (body.symbol === 'SHUTTING_DOWN' && !last)
      mayResubmit.add(error);
    this.#open.delete(h.id);
    this.#asked.delete(h.id);
    request?.settle(error);
    question?.reject(error);
    if (last)
      this.#lose(error);
  }

  #tell(request, body) {
    try {
      request.onProgress(body);
    } catch (error) {
      this.#abort(request, error);
    }
  }

  #onEnd(h, reply, request) {
    this.#open.delete(h.id);
    if (h.type === 'ASSET_KEPT')
      return request.settle(null, { reply });
    const kind = reply.output?.kind ?? 'NONE', size = reply.output?.size ?? 0n, wanted = request.output ? 'INLINE' : 'NONE';
    if (kind !== wanted || size !== BigInt(request.got) || (request.expectBytes !== undefined && request.got !== request.expectBytes))
      return request.settle(new AiryError('PAYLOAD', `the result has output ${kind} of ${size} bytes, expected ${wanted} of ${
        request.expectBytes ?? request.got}; ${request.got} came`, { field: 'output.size' }));
    request.settled || request.settle(null, { reply, size: request.got, output: request.sink?.whole() ?? null });
  }

  // ---- the end --------------------------------------------------------------------------------------

  #gone(text, cause) {
    const symbol = this.#welcome ? 'DISCONNECTED' : 'CONNECT';
    return new AiryError(symbol, `${this.#path}: ${text}`, { field: this.#welcome ? '' : 'socket', retryable: true, cause });
  }

  // Each request gets an error of its own, for each may be asked again or not.
  #again(error, request) {
    if (!(error instanceof AiryError))
      return error;
    const own = error.again();
    const sent = request.id !== undefined;
    if (error.retryable && !request.sink?.handedOn && !(request.once && sent))
      mayResubmit.add(own);
    return own;
  }

  #lose(error) {
    if (this.#lost)
      return;
    this.#lost = error;
    this.#socket.destroy();
    const requests = [...this.#waiting, ...this.#open.values()], questions = [...this.#asked.values()];
    this.#waiting = [];
    this.#uploads = [];
    this.#open.clear();
    this.#asked.clear();
    for (const request of requests)
      request.settle(this.#again(error, request));
    for (const question of questions)
      question.reject(this.#again(error, question));
    if (!this.#welcome)
      this.#greeted(error);
  }
}
