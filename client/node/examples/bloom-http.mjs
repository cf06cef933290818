#!/usr/bin/env node
// SPDX-License-Identifier: Apache-2.0
// bloom-http.mjs - blooms an EXR that is posted, parameters in the query:
//
//     node bloom-http.mjs 8080 &
//     curl --data-binary @in.exr 'http://localhost:8080/bloom?threshold=1.5' -o out.exr
//
// Who goes away cancels the request. It listens on this machine only, and knows no users: put a server that does before it.
import { createServer } from 'node:http';
import { connect } from '@airyd/client';

const BODY_BYTES_MAX = 512 * 1024 * 1024;
const port = Number(process.argv[2] ?? 8080);
const airy = await connect({ reconnect: true });

async function read(request) {
  const length = Number(request.headers['content-length']);
  if (!(length > 0 && length <= BODY_BYTES_MAX))
    throw Object.assign(new Error(`Content-Length is ${length}, expected 1 to ${BODY_BYTES_MAX}`), { status: 413 });
  const body = Buffer.alloc(length);
  let at = 0;
  for await (const piece of request)
    at += piece.copy(body, at);
  return body;
}

const statusOf = (error) => error.status ?? (error.retryable ? 503 : error.symbol ? 422 : 500);

createServer(async (request, response) => {
  const gone = new AbortController();
  response.once('close', () => gone.abort());
  try {
    const { pathname, searchParams } = new URL(request.url, 'http://localhost');
    if (request.method !== 'POST' || pathname !== '/bloom')
      throw Object.assign(new Error('POST /bloom is all there is'), { status: 404 });
    const result = await airy.bloom(await read(request), Object.fromEntries(searchParams), { signal: gone.signal });
    response.writeHead(200, {
      'Content-Type': 'image/x-exr',
      'Content-Length': result.output.length,
      'X-Airy-Error-Bound': result.bound,
      'X-Airy-Ms': result.ms.total.toFixed(1),
    }).end(result.output);
  } catch (error) {
    if (response.destroyed)
      return;
    const retry = error.retryable ? { 'Retry-After': Math.ceil((error.retryAfterMs || 1000) / 1000) } : {};
    response.writeHead(statusOf(error), { 'Content-Type': 'application/json', ...retry })
      .end(`${JSON.stringify({ symbol: error.symbol, field: error.field, text: error.text ?? error.message })}\n`);
  }
}).listen(port, '127.0.0.1', function () {
  console.log(`http://127.0.0.1:${this.address().port}/bloom on ${airy.server}`);
});
