// SPDX-License-Identifier: Apache-2.0
// frame.js - the 24 bytes before every body: written, and read from a stream that may be cut anywhere. Pure: no sockets.
//
// Every check of PROTOCOL.md section 2 is made on the header alone, in its order, before memory is taken for the body. DATA is handed on
// in the pieces in which it comes, so that a payload is never held twice.
import { types } from '../gen/contract.js';

export const HEADER_BYTES = 24, VERSION = 1, DATA_BYTES_MAX = 1024 * 1024, BODY_BYTES_MAX = 64 * 1024;
const MAGIC = 0x59524941;
const byName = new Map(types.map((t) => [t.name, t])), byNumber = new Map(types.map((t) => [t.number, t]));

/** What was received is not the protocol; `symbol` is PROTOCOL.md's. */
export class FrameError extends Error {
  constructor(symbol, field, text) {
    super(text);
    this.name = 'FrameError';
    this.symbol = symbol;
    this.field = field;
  }
}

/** The name of a message type's body in airy.proto: STATUS_REPLY is StatusReply. */
export const bodyName = (type) => type.toLowerCase().replace(/(^|_)(.)/g, (_, before, c) => c.toUpperCase());

export function encodeHeader(type, id, bodyBytes, nFds = 0) {
  const out = Buffer.alloc(HEADER_BYTES);
  out.writeUInt32LE(MAGIC, 0);
  out[4] = VERSION;
  out[5] = byName.get(type).number;
  out[6] = nFds;
  out.writeUInt32LE(bodyBytes, 8);
  out.writeBigUInt64LE(BigInt(id), 16);
  return out;
}

/** Decodes and checks a header that `sender` ("daemon" or "client") sent: { type, nFds, bodyBytes, id }. */
export function decodeHeader(bytes, sender) {
  const magic = bytes.readUInt32LE(0);
  if (magic !== MAGIC)
    throw new FrameError('BAD_MAGIC', 'header.magic', `header.magic is 0x${magic.toString(16)}, expected 0x${MAGIC.toString(16)}`);
  if (bytes[4] !== VERSION)
    throw new FrameError('BAD_VERSION', 'header.version', `header.version is ${bytes[4]}, expected ${VERSION}`);
  const type = byNumber.get(bytes[5]);
  if (!type?.by.includes(sender))
    throw new FrameError('UNEXPECTED', 'header.type',
      `header.type is ${bytes[5]}${type ? ` (${type.name})` : ''}, which the ${sender} does not send`);
  const bodyBytes = bytes.readUInt32LE(8), most = type.name === 'DATA' ? DATA_BYTES_MAX : BODY_BYTES_MAX;
  if (bodyBytes > most)
    throw new FrameError('TOO_LONG', 'header.body_bytes', `header.body_bytes of ${type.name} is ${bodyBytes}, expected at most ${most}`);
  if (bytes[6] > type.fds)
    throw new FrameError('BAD_FDS', 'header.n_fds', `header.n_fds of ${type.name} is ${bytes[6]}, expected at most ${type.fds}`);
  if (bytes[7] !== 0)
    throw new FrameError('BAD_BODY', 'header.flags', `header.flags is ${bytes[7]}, expected 0`);
  const reserved = bytes.readUInt32LE(12);
  if (reserved !== 0)
    throw new FrameError('BAD_BODY', 'header.reserved', `header.reserved is ${reserved}, expected 0`);
  return { type: type.name, nFds: bytes[6], bodyBytes, id: bytes.readBigUInt64LE(16) };
}

/**
 * Cuts a stream into messages. The sink has header(h) as soon as a header is there, data(h, piece) for each piece of a DATA's body, and
 * message(h, body) when a message is whole (of DATA, body is null). What the sink throws ends push().
 */
export class FrameReader {
  #sender;
  #sink;
  #head = Buffer.alloc(HEADER_BYTES);
  #got = 0; // bytes of the header, then of the body
  #header = null;
  #body = null;

  constructor(sender, sink) {
    this.#sender = sender;
    this.#sink = sink;
  }

  push(chunk) {
    let at = 0;
    while (at < chunk.length || (this.#header && this.#got === this.#header.bodyBytes)) {
      if (!this.#header) {
        const n = Math.min(HEADER_BYTES - this.#got, chunk.length - at);
        chunk.copy(this.#head, this.#got, at, at + n);
        at += n;
        this.#got += n;
        if (this.#got < HEADER_BYTES)
          return;
        const h = decodeHeader(this.#head, this.#sender);
        this.#sink.header(h);
        this.#header = h;
        this.#got = 0;
        this.#body = h.type === 'DATA' ? null : Buffer.alloc(h.bodyBytes);
      }
      const h = this.#header, n = Math.min(h.bodyBytes - this.#got, chunk.length - at);
      const piece = chunk.subarray(at, at + n);
      at += n;
      if (this.#body)
        piece.copy(this.#body, this.#got);
      else if (n)
        this.#sink.data(h, piece);
      this.#got += n;
      if (this.#got < h.bodyBytes)
        return;
      const body = this.#body;
      this.#header = this.#body = null;
      this.#got = 0;
      this.#sink.message(h, body);
    }
  }

  /** Is the stream between two messages? */
  get whole() {
    return !this.#header && this.#got === 0;
  }
}
