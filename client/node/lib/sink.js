// SPDX-License-Identifier: Apache-2.0
// sink.js - where the bytes of one result go as they come: into memory, once, or into the caller's Writable. A Writable that is full, or
// has not yet drained, holds the socket, so that a slow consumer slows the daemon down instead of filling this process.
import { AiryError } from './errors.js';

// The size of an EXR result is known at its end: its pieces are kept, and joined once.
class Pieces {
  #pieces = [];
  handedOn = false;

  take(piece) {
    this.#pieces.push(piece);
  }

  whole() {
    return this.#pieces.length === 1 ? this.#pieces[0] : Buffer.concat(this.#pieces);
  }

  release() {}
}

// A raw result is as long as its input: it is laid where it stays. Memory is taken when its first byte has come.
class Placed {
  #size;
  #out = null;
  #at = 0;
  handedOn = false;

  constructor(size) {
    this.#size = size;
  }

  take(piece) {
    this.#out ??= Buffer.from(new ArrayBuffer(this.#size));
    piece.copy(this.#out, this.#at);
    this.#at += piece.length;
  }

  whole() {
    return this.#out ?? Buffer.alloc(0);
  }

  release() {}
}

class Passed {
  #into;
  #socket;
  #holding = false;
  #onDrain = () => this.#let();
  #onError = (cause) => this.#socket.fail(new AiryError('ARGUMENT', 'the Writable failed', { field: 'into', cause }));
  #onClose = () => this.#socket.fail(new AiryError('ARGUMENT', 'the Writable was closed before the result was written', { field: 'into' }));
  handedOn = false;

  constructor(into, socket) {
    this.#into = into;
    this.#socket = socket;
    into.on('drain', this.#onDrain).once('error', this.#onError).once('close', this.#onClose);
  }

  take(piece) {
    this.handedOn = true;
    if (!this.#into.write(piece) && !this.#holding) {
      this.#holding = true;
      this.#socket.hold();
    }
  }

  #let() {
    if (!this.#holding)
      return;
    this.#holding = false;
    this.#socket.release();
  }

  whole() {
    return null;
  }

  release() {
    this.#into.off('drain', this.#onDrain).off('error', this.#onError).off('close', this.#onClose);
    this.#let();
  }
}

/** A sink for `request`; `socket` is { hold, release, fail }. */
export function makeSink({ into, expectBytes }, maxBytes, socket) {
  if (into)
    return new Passed(into, socket);
  return expectBytes === undefined ? new Pieces() : new Placed(Math.min(expectBytes, maxBytes));
}
