// SPDX-License-Identifier: Apache-2.0
// stream.js - frames in, bloomed frames out, in order, with `highWaterMark` of them between the two.
//
// A frame counts from when it is written until the reader has taken it, so a reader that falls behind stops the submitting, and
// memory holds so many frames and no more. A Duplex rather than a Transform: a Transform has one frame in hand, and the daemon is fast
// when it has several.
import { Duplex } from 'node:stream';
import { argument } from './errors.js';

export class BloomStream extends Duplex {
  #airy;
  #params;
  #options;
  #window;
  #queue = []; // { done, value } in the order of their coming
  #wanted = false; // the reader has room
  #next = null; // lets the writer go on
  #finish = null;
  #index = 0;
  #stop = new AbortController();

  constructor(airy, params, { highWaterMark = 4, results = false, onError, signal, ...bloom } = {}) {
    if (!Number.isInteger(highWaterMark) || highWaterMark < 1)
      throw argument('highWaterMark', `highWaterMark is ${highWaterMark}, expected a whole number from 1`);
    super({ objectMode: true, readableHighWaterMark: 1, writableHighWaterMark: 1, signal });
    this.#airy = airy;
    this.#params = params;
    this.#window = highWaterMark;
    this.#options = { results, onError, bloom };
    // Of frames that are shown nothing comes out, and nobody need look.
    if (bloom.show && !results)
      this.resume();
  }

  _write(frame, encoding, next) {
    const entry = { done: false, value: undefined };
    this.#queue.push(entry);
    this.#one(frame, this.#index++, entry);
    if (this.#queue.length < this.#window)
      next();
    else
      this.#next = next;
  }

  async #one(frame, index, entry) {
    try {
      const result = await this.#airy.bloom(frame, this.#params, { ...this.#options.bloom, signal: this.#stop.signal });
      entry.value = this.#options.results ? result : result.output ?? undefined;
    } catch (error) {
      if (this.destroyed)
        return;
      error.index = index;
      try {
        // One bad frame costs one frame, where the caller says what stands for it; undefined: nothing does.
        if (!this.#options.onError)
          throw error;
        entry.value = await this.#options.onError(error, index, frame);
      } catch (fatal) {
        this.destroy(fatal);
        return;
      }
    }
    entry.done = true;
    this.#drain();
  }

  #drain() {
    while (this.#wanted && this.#queue[0]?.done) {
      const { value } = this.#queue.shift();
      if (value !== undefined && value !== null)
        this.#wanted = this.push(value);
    }
    if (this.#queue.length < this.#window && this.#next) {
      const next = this.#next;
      this.#next = null;
      next();
    }
    if (!this.#queue.length && this.#finish) {
      this.push(null);
      this.#finish();
      this.#finish = null;
    }
  }

  _read() {
    this.#wanted = true;
    this.#drain();
  }

  _final(done) {
    this.#finish = done;
    this.#drain();
  }

  _destroy(error, done) {
    this.#stop.abort(error ?? undefined);
    done(error);
  }
}
