// SPDX-License-Identifier: Apache-2.0
// hostile.mjs - daemons that break the contract, which no real one does: what they send is refused with the contract's symbol, costs no
// memory, and ends the promise. Each is a server of the test's own, for one connection.
import assert from 'node:assert/strict';
import { connect } from '../lib/index.js';
import { check, falseDaemon, LIMITS, rejects } from './kit.mjs';

const HEADER = Buffer.from('4149525901050000000000000000000001000000000000 00'.replace(' ', ''), 'hex'); // RESULT for request 1
const patched = (at, ...bytes) => { const h = Buffer.from(HEADER); h.set(bytes, at); return h; };
const FRAME = Buffer.alloc(16, 7);
const RAW = { raw: { width: 2, height: 2, type: 'half', channels: 'RG' } };

// Answers the first BLOOM (with all its DATA) by `answer`, and sees what the client makes of it.
async function answered(answer, wanted, ask = (airy) => airy.bloom(FRAME)) {
  const daemon = await falseDaemon(async (peer) => {
    for (let m; (m = await peer.next());)
      if (m.type === 'DATA' || m.type === 'STATUS')
        await answer(peer, m.id);
  });
  const airy = await connect({ path: daemon.path, reconnect: false });
  try {
    const asked = ask(airy);
    return wanted ? await rejects(asked, wanted) : await asked;
  } finally {
    airy.close();
    daemon.close();
  }
}

const bad = (symbol, field) => ({ symbol, origin: 'client', retryable: false, ...(field && { field }) });

async function refused() {
  const cases = {
    'no magic': [(p) => p.socket.write(patched(0, 0x48, 0x54, 0x54, 0x50)), bad('BAD_MAGIC', 'header.magic')],
    'another version': [(p) => p.socket.write(patched(4, 2)), bad('BAD_VERSION', 'header.version')],
    'no such type': [(p) => p.socket.write(patched(5, 99)), bad('UNEXPECTED', 'header.type')],
    'a client\'s message': [(p) => p.socket.write(patched(5, 3)), bad('UNEXPECTED', 'header.type')],
    'a body of 4 GB': [(p) => p.socket.write(patched(8, 255, 255, 255, 255)), bad('TOO_LONG', 'header.body_bytes')],
    'DATA of 1 MiB and a byte': [(p) => p.socket.write(patched(5, 4, 0, 0, 1, 0, 16, 0)), bad('TOO_LONG', 'header.body_bytes')],
    'descriptors with PROGRESS': [(p) => p.socket.write(patched(5, 12, 1)), bad('BAD_FDS', 'header.n_fds')],
    'a descriptor that nobody asked for': [(p) => p.socket.write(patched(6, 1)), bad('BAD_FDS', 'header.n_fds')],
    'flags': [(p) => p.socket.write(patched(7, 1)), bad('BAD_BODY', 'header.flags')],
    'reserved bytes': [(p) => p.socket.write(patched(12, 1)), bad('BAD_BODY', 'header.reserved')],
    'a damaged body': [(p, id) => p.send('RESULT', id, Buffer.from('0a05', 'hex')), bad('BAD_BODY', 'Result.output')],
    'CANCELLED with a body': [(p, id) => p.send('CANCELLED', id, Buffer.from('0801', 'hex')), bad('UNEXPECTED')],
    'a body that would fill the memory': [(p, id) => p.send('RESULT', id, Buffer.alloc(60_000, Buffer.from([0x12, 0]))),
      bad('BAD_BODY', 'Result.targets')],
    'WELCOME twice': [(p) => p.send('WELCOME', 0n, { version: 1, limits: LIMITS }), bad('UNEXPECTED', 'header.type')],
    'a RESULT for nobody': [(p) => p.send('RESULT', 77n, {}), bad('UNEXPECTED', 'header.type')],
    'an ERROR for nobody': [(p) => p.send('ERROR', 77n, { code: 400, symbol: 'BUSY' }), bad('UNEXPECTED', 'header.type')],
    'ASSET_KEPT for a bloom': [(p, id) => p.send('ASSET_KEPT', id, {}), bad('UNEXPECTED', 'header.type')],
    'CANCELLED that nobody asked for': [(p, id) => p.send('CANCELLED', id), bad('UNEXPECTED', 'header.type')],
    'STATUS_REPLY that nobody asked for': [(p) => p.send('STATUS_REPLY', 5n, {}), bad('UNEXPECTED', 'header.type')],
    'DATA for nobody': [(p) => p.send('DATA', 77n, Buffer.alloc(4)), bad('UNEXPECTED', 'header.type')],
    'DATA after the end': [(p, id) => { p.send('ERROR', id, { code: 500, symbol: 'INTERNAL', text: 'x' }); p.send('DATA', id, FRAME); },
      { symbol: 'INTERNAL', origin: 'daemon' }],
    'more credit than is out': [(p) => p.send('CREDIT', 0n, { bytes: 17 }), bad('BAD_BODY', 'credit.bytes')],
    'credit of 2^64 - 1': [(p) => p.send('CREDIT', 0n, { bytes: 2n ** 64n - 1n }), bad('BAD_BODY', 'credit.bytes')],
    'more output than any frame': [(p, id) => { for (let i = 0; i < 3; i++) p.send('DATA', id, Buffer.alloc(LIMITS.maxFrameBytes / 2)); },
      bad('PAYLOAD', 'output.size')],
    'a size that is not that of the DATA': [(p, id) => { p.send('DATA', id, FRAME); p.send('RESULT', id, { output: { kind: 'INLINE', size: 15 } }); },
      bad('PAYLOAD', 'output.size')],
    'a memfd that nobody asked for': [(p, id) => p.send('RESULT', id, { output: { kind: 'MEMFD', size: 16 } }), bad('PAYLOAD', 'output.size')],
    'silence and the end': [(p) => p.socket.end(), { symbol: 'DISCONNECTED', retryable: true }],
    'an ERROR of the connection': [(p) => { p.send('ERROR', 0n, { code: 502, symbol: 'SHUTTING_DOWN', text: 'stopping', retryable: true }); p.socket.end(); },
      { symbol: 'SHUTTING_DOWN', code: 502, origin: 'daemon', retryable: true, text: 'stopping' }],
    // What no client can cause from outside: a fault in the daemon, a lost device.
    'a fault in the daemon': [(p, id) => p.send('ERROR', id, { code: 500, symbol: 'INTERNAL', text: 'it is so' }),
      { symbol: 'INTERNAL', code: 500, origin: 'daemon', retryable: false }],
    'a lost device': [(p, id) => p.send('ERROR', id, { code: 501, symbol: 'DEVICE_LOST', text: 'it is so', retryable: true }),
      { symbol: 'DEVICE_LOST', code: 501, origin: 'daemon', retryable: true }],
    'an error of the future': [(p, id) => p.send('ERROR', id, { code: 999, symbol: 'TIRED', text: 'so tired', field: 'x' }),
      { symbol: 'TIRED', code: 999, field: 'x', retryable: false }],
  };
  for (const [name, [answer, wanted]] of Object.entries(cases))
    await check(`from the daemon: ${name}`, () => answered(answer, wanted));
  await check('from the daemon: raw output longer or shorter than its input', async () => {
    const ask = (airy) => airy.bloom(FRAME, {}, RAW);
    await answered((p, id) => p.send('DATA', id, Buffer.alloc(17)), bad('PAYLOAD', 'output.size'), ask);
    await answered((p, id) => { p.send('DATA', id, Buffer.alloc(8)); p.send('RESULT', id, { output: { kind: 'INLINE', size: 8 } }); },
      bad('PAYLOAD', 'output.size'), ask);
  });
  await check('from the daemon: output of a plan', () =>
    answered((p, id) => p.send('DATA', id, Buffer.alloc(1)), bad('UNEXPECTED', 'header.type'), (airy) => airy.plan(FRAME)));
  await check('from the daemon: a digest that is none', () =>
    answered((p, id) => p.send('ASSET_KEPT', id, { digest: '../../etc/passwd' }), bad('BAD_BODY', 'digest'), (airy) => airy.asset(FRAME)));
}

async function greetings() {
  const cases = {
    'version 2': [(p) => p.send('WELCOME', 0n, { version: 2, limits: LIMITS }), { symbol: 'BAD_VERSION' }],
    'no limits': [(p) => p.send('WELCOME', 0n, { version: 1 }), { symbol: 'BAD_BODY', field: 'limits.maxFrameBytes' }],
    'a limit of 0': [(p) => p.send('WELCOME', 0n, { version: 1, limits: { ...LIMITS, maxRequests: 0 } }),
      { symbol: 'BAD_BODY', field: 'limits.maxRequests' }],
    'a limit of 2^60': [(p) => p.send('WELCOME', 0n, { version: 1, limits: { ...LIMITS, maxFrameBytes: 2n ** 60n } }),
      { symbol: 'BAD_BODY', field: 'limits.maxFrameBytes' }],
    'less credit than a frame': [(p) => p.send('WELCOME', 0n, { version: 1, limits: { ...LIMITS, creditBytes: 5 } }),
      { symbol: 'BAD_BODY', field: 'limits.creditBytes' }],
    'a RESULT': [(p) => p.send('RESULT', 1n, {}), { symbol: 'UNEXPECTED' }],
    'an ERROR': [(p) => p.send('ERROR', 0n, { code: 101, symbol: 'BAD_VERSION', text: 'no' }), { symbol: 'BAD_VERSION', code: 101, origin: 'daemon' }],
    'the end': [(p) => p.socket.end(), { symbol: 'CONNECT', field: 'socket', retryable: true }],
    'nothing': [() => {}, { symbol: 'CONNECT', field: 'socket', retryable: true }],
  };
  for (const [name, [answer, wanted]] of Object.entries(cases))
    await check(`HELLO answered by ${name}`, async () => {
      const daemon = await falseDaemon(answer, { greet: false });
      await rejects(connect({ path: daemon.path, reconnect: false, timeoutMs: name === 'nothing' ? 200 : 20_000 }), wanted);
      daemon.close();
    });
}

async function behaviour() {
  await check('a good answer, byte by byte', async () => {
    const result = await answered(async (peer, id) => {
      const { socket } = peer, write = socket.write.bind(socket);
      const pieces = [];
      socket.write = (bytes) => pieces.push(bytes);
      peer.send('CREDIT', 0n, { bytes: 16 });
      peer.send('DATA', id, Buffer.from('one '));
      peer.send('DATA', id, Buffer.alloc(0));
      peer.send('PROGRESS', id, { stage: 'bloom', fraction: 0.5 });
      peer.send('DATA', id, Buffer.from('two'));
      peer.send('RESULT', id, { output: { kind: 'INLINE', size: 7 }, notes: ['a', 'b'], targets: [{ errorBound: 1 }, { errorBound: 3 }] });
      socket.write = write;
      for (const byte of Buffer.concat(pieces)) {
        write(Buffer.from([byte]));
        await new Promise((resolve) => setImmediate(resolve));
      }
    });
    assert.equal(result.output.toString(), 'one two');
    assert.deepEqual([result.notes, result.bound], [['a', 'b'], 3]);
  });
  // PROGRESS may be left out by a real daemon: this one sends it.
  await check('a callback that throws ends its own request, by CANCEL', async () => {
    const why = new Error('mine'), seen = [];
    const daemon = await falseDaemon(async (peer) => {
      for (let m; (m = await peer.next());) {
        seen.push(m.type);
        if (m.type === 'DATA')
          peer.send('PROGRESS', m.id, { stage: 'bloom', fraction: 0.5 });
        else if (m.type === 'CANCEL')
          peer.send('CANCELLED', m.id);
        else if (m.type === 'STATUS')
          peer.send('STATUS_REPLY', m.id, {});
      }
    });
    const airy = await connect({ path: daemon.path, reconnect: false });
    await assert.rejects(airy.bloom(FRAME, {}, { onProgress: () => { throw why; } }), why);
    await airy.status();
    assert.equal(airy.pending, 0);
    assert.deepEqual(seen, ['BLOOM', 'DATA', 'CANCEL', 'STATUS']);
    airy.close();
    daemon.close();
  });
  const busy = { code: 400, symbol: 'BUSY', text: 'later', retryable: true, retryAfterMs: 1 };
  await check('BUSY is asked again, so often as allowed and no more', async () => {
    for (const [retries, refusals] of [[5, 3], [2, 99], [0, 99]]) {
      let asked = 0;
      const daemon = await falseDaemon(async (peer) => {
        for (let m; (m = await peer.next());)
          if (m.type === 'DATA') {
            peer.send('CREDIT', 0n, { bytes: 16 });
            if (asked++ < refusals)
              peer.send('ERROR', m.id, busy);
            else
              peer.send('RESULT', m.id, { output: { kind: 'INLINE' } });
          }
      });
      const airy = await connect({ path: daemon.path, reconnect: false, busyRetries: retries });
      if (refusals > retries)
        await rejects(airy.bloom(FRAME), { symbol: 'BUSY', code: 400, retryable: true, retryAfterMs: 1 });
      else
        assert.equal((await airy.bloom(FRAME)).size, 0);
      assert.equal(asked, Math.min(retries, refusals) + 1);
      airy.close();
      daemon.close();
    }
  });
  await check('a wait for BUSY ends with its signal', () => {
    const stop = new AbortController();
    return answered((p, id) => { p.send('CREDIT', 0n, { bytes: 16 }); p.send('ERROR', id, { ...busy, retryAfterMs: 4e9 }); setImmediate(() => stop.abort()); },
      { symbol: 'CANCELLED', name: 'AbortError' }, (airy) => airy.bloom(FRAME, {}, { signal: stop.signal }));
  });
  await check('no request is sent beyond the credit and the requests allowed, and all are served', async () => {
    let open = 0, most = 0, bytes = 0, mostBytes = 0;
    const sizes = new Map();
    const daemon = await falseDaemon(async (peer) => {
      for (let m; (m = await peer.next());) {
        if (m.type === 'BLOOM') {
          sizes.set(m.id, { size: Number(m.body.input.size), got: 0 });
          most = Math.max(most, ++open);
          mostBytes = Math.max(mostBytes, bytes += Number(m.body.input.size));
        }
        const r = sizes.get(m.id);
        if (m.type === 'DATA' && (r.got += m.data.length) === r.size)
          setTimeout(() => {
            open--;
            bytes -= r.size;
            peer.send('RESULT', m.id, { output: { kind: 'INLINE' } });
            peer.send('CREDIT', 0n, { bytes: r.size });
          }, 2);
      }
    });
    const airy = await connect({ path: daemon.path, reconnect: false });
    await Promise.all(Array.from({ length: 40 }, (_, i) => airy.bloom(Buffer.alloc((i % 4 + 1) * 200_000))));
    assert.ok(most > 1 && most <= LIMITS.maxRequests, `${most} were open`);
    assert.ok(mostBytes > 400_000 && mostBytes <= LIMITS.creditBytes, `${mostBytes} bytes were out`);
    await rejects(airy.bloom(Buffer.alloc(LIMITS.maxFrameBytes + 1)), { symbol: 'LIMIT', code: 401, field: 'input.size', origin: 'client' });
    airy.close();
    daemon.close();
  });
  await check('an ERROR that comes before the upload has ended, is heard', async () => {
    const big = Buffer.alloc(LIMITS.maxFrameBytes);
    const daemon = await falseDaemon(async (peer) => {
      const bloom = await peer.next();
      peer.socket.pause();
      peer.send('ERROR', bloom.id, { code: 200, symbol: 'PARAM_UNKNOWN', text: 'no', field: 'params.x' });
      peer.send('CREDIT', 0n, { bytes: big.length });
      setTimeout(() => peer.socket.resume(), 20);
      for (let m; (m = await peer.next());)
        if (m.type === 'STATUS')
          peer.send('STATUS_REPLY', m.id, { done: 5 });
    });
    const airy = await connect({ path: daemon.path, reconnect: false });
    await rejects(airy.bloom(big), { symbol: 'PARAM_UNKNOWN', field: 'params.x' });
    assert.equal((await airy.status()).done, 5n);
    airy.close();
    daemon.close();
  });
}

export async function hostile() {
  await refused();
  await greetings();
  await behaviour();
}
