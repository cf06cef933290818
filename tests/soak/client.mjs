// SPDX-License-Identifier: Apache-2.0
// client.mjs SPEC SEED SECONDS PACKAGE - a well-behaved client in Node, as client.py is in Python: one JSON line a frame, {"case", "sha"},
// {"case", "error"} or {"cancelled"}. PACKAGE: the folder of the made Node package. It may be killed or stopped at any moment.
import { createHash } from 'node:crypto';
import { readFileSync } from 'node:fs';
import { pathToFileURL } from 'node:url';

const [specPath, seed, seconds, folder] = process.argv.slice(2);
const { connect } = await import(pathToFileURL(`${folder}/lib/index.js`).href);
const spec = JSON.parse(readFileSync(specPath, 'utf8'));
const say = (line) => process.stdout.write(`${JSON.stringify(line)}\n`);

// xorshift32: Math.random has no seed.
let state = Number(seed) % 0xffffffff + 1 >>> 0;
function below(n) {
  state ^= state << 13; state >>>= 0;
  state ^= state >>> 17;
  state ^= state << 5; state >>>= 0;
  return state % n;
}

async function one(airy, c) {
  const { show, ...params } = c.params;
  if (show !== undefined) params.view = show;
  const abort = new AbortController();
  try {
    if (c.dirt) params.dirt = (await airy.asset(readFileSync(c.dirt))).digest;
    if (below(10) === 0) setTimeout(() => abort.abort(), below(60));
    const { output } = await airy.bloom(readFileSync(c.input), params, { signal: abort.signal, ...(c.raw ? { raw: c.raw } : { exr: c.exr }) });
    say({ case: c.id, sha: createHash('sha256').update(output).digest('hex') });
  } catch (e) {
    if (e.symbol === 'CANCELLED') say({ cancelled: c.id });
    else say({ case: c.id, error: e.symbol ?? String(e), text: String(e.stack ?? e), retryable: e.retryable === true && e.origin === 'daemon' });
  }
}

const end = performance.now() + 1000 * Number(seconds);
// Where daemons are killed it finds the next one, and asks again what was in flight.
const reconnect = spec.reconnect ? { attempts: 1000, delayMsMax: 200 } : false;
const airy = await connect({ path: spec.socket, timeoutMs: 120000, reconnect });
while (performance.now() < end) {
  const first = spec.cases[below(spec.cases.length)];
  const small = spec.cases.filter((c) => c.pixels <= 2 ** 20);
  const batch = [first];
  if (first.pixels <= 2 ** 20)
    for (let i = below(5); i > 0; i--) batch.push(small[below(small.length)]);
  await Promise.all(batch.map((c) => one(airy, c)));
}
airy.close();
