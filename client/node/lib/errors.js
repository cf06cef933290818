// SPDX-License-Identifier: Apache-2.0
// errors.js - what can go wrong, as one class: the daemon's errors as PROTOCOL.md section 8 has them, and this side's, which have
// code 0 and a symbol of their own: ARGUMENT (the call is wrong), CONNECT (no daemon answers), DISCONNECTED (the connection is gone),
// CANCELLED (an AbortSignal). What the daemon sent and PROTOCOL.md forbids has the contract's symbol, and `origin` "client".
import { faults } from '../gen/contract.js';

const bySymbol = new Map(faults.map((f) => [f.symbol, f]));
const byCode = new Map(faults.map((f) => [f.code, f]));

export class AiryError extends Error {
  constructor(symbol, text, { code, field = '', retryable, retryAfterMs = 0, queuePosition = 0, origin = 'client', cause } = {}) {
    super(field && !text.includes(field) ? `${symbol}: ${field}: ${text}` : `${symbol}: ${text}`, cause === undefined ? undefined : { cause });
    const known = bySymbol.get(symbol);
    this.name = 'AiryError';
    this.code = code ?? known?.code ?? 0;
    this.symbol = symbol;
    this.text = text;
    this.field = field;
    this.retryable = retryable ?? known?.retryable ?? false;
    this.retryAfterMs = retryAfterMs;
    this.queuePosition = queuePosition;
    this.origin = origin;
  }

  /** The same for another request, with a trace of its own. */
  again() {
    return new AiryError(this.symbol, this.text, { ...this, cause: this.cause });
  }
}

/** An AbortSignal's end; `cause` is its reason. Named as Node names its own, so that code which looks for that finds it. */
export class AiryAbortError extends AiryError {
  constructor(reason) {
    super('CANCELLED', 'the request was cancelled', { cause: reason });
    this.name = 'AbortError';
  }
}

/** An AiryError from a decoded Error message. */
export function fromDaemon(body) {
  return new AiryError(body.symbol || `CODE_${body.code}`, body.text, { ...body, origin: 'daemon' });
}

/** Is an error with this code the last message on its connection? */
export const closes = (code) => byCode.get(code)?.closes ?? false;

export const argument = (field, text) => new AiryError('ARGUMENT', text, { field });
