// SPDX-License-Identifier: Apache-2.0
// index.js - the package: index.d.ts is its manual.
export { Airy, connect } from './client.js';
export { AiryAbortError, AiryError } from './errors.js';
export { BloomStream } from './stream.js';
