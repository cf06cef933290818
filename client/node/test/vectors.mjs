// SPDX-License-Identifier: Apache-2.0
// vectors.mjs - the golden vectors: good ones decode to their JSON and encode to their bytes, whole and cut anywhere; bad ones are
// refused with their symbol.
import assert from 'node:assert/strict';
import { readdirSync, readFileSync } from 'node:fs';
import { join } from 'node:path';
import { schema } from '../gen/contract.js';
import { bodyName, encodeHeader, FrameReader } from '../lib/frame.js';
import { BodyError, decode, encode } from '../lib/protobuf.js';
import { check, root, toJson } from './kit.mjs';

// The messages in `bytes`, given in pieces of at most `step`.
function read(bytes, sender, step = bytes.length) {
  const out = [];
  let data = Buffer.alloc(0);
  const reader = new FrameReader(sender, {
    header: () => { data = Buffer.alloc(0); },
    data: (h, piece) => { data = Buffer.concat([data, piece]); },
    message: (h, body) => {
      const name = bodyName(h.type);
      if (body && schema.messages[name])
        out.push({ h, body: decode(schema, name, body) });
      else
        out.push({ h, data: h.type === 'DATA' ? data : body });
    },
  });
  for (let at = 0; at < bytes.length; at += step)
    reader.push(bytes.subarray(at, at + step));
  assert.ok(reader.whole, 'nothing is left over');
  return out;
}

function good(v) {
  const bytes = Buffer.from(v.hex, 'hex');
  for (const step of [bytes.length, 1, 7]) {
    const [{ h, body, data }, ...more] = read(bytes, v.from, step);
    assert.equal(more.length, 0);
    assert.deepEqual({ type: h.type, n_fds: h.nFds, flags: 0, body_bytes: h.bodyBytes, id: String(h.id) },
      (({ number, ...rest }) => rest)(v.header));
    if (v.data !== undefined)
      assert.equal(data.toString('hex'), v.data);
    else if (body)
      assert.deepEqual(toJson(bodyName(h.type), body), v.body);
  }
  const body = v.data !== undefined ? Buffer.from(v.data, 'hex')
    : schema.messages[bodyName(v.header.type)] ? encode(schema, bodyName(v.header.type), v.body) : Buffer.alloc(0);
  assert.equal(Buffer.concat([encodeHeader(v.header.type, BigInt(v.header.id), body.length, v.header.n_fds), body]).toString('hex'), v.hex);
}

function bad(v) {
  const bytes = Buffer.from(v.hex, 'hex');
  for (const step of [bytes.length, 1])
    assert.throws(() => read(bytes, v.from, step), (error) => {
      assert.equal(error.symbol ?? (error instanceof BodyError ? 'BAD_BODY' : error), v.error);
      assert.ok(error.field && error.message.length > 10);
      return true;
    });
}

export async function vectors() {
  const folder = join(root, 'proto/vectors');
  const all = readdirSync(folder).filter((f) => f.endsWith('.json')).sort().map((f) => JSON.parse(readFileSync(join(folder, f), 'utf8')));
  for (const v of all)
    await check(`vector ${v.name}`, async () => {
      const hex = readFileSync(join(folder, `${v.name}.hex`), 'utf8').replace(/\s/g, '');
      assert.equal(hex, v.hex);
      v.error ? bad(v) : good(v);
    });
  await check('vectors: there are good and bad ones of both ends', async () => {
    assert.ok(all.filter((v) => !v.error).length >= 20 && all.filter((v) => v.error).length >= 15, `${all.length} vectors`);
    assert.deepEqual([...new Set(all.map((v) => v.from))].sort(), ['client', 'daemon']);
  });
  await check('every good vector, back to back, cut at every length up to 64', async () => {
    for (const from of ['client', 'daemon']) {
      const some = all.filter((v) => v.from === from && !v.error);
      const stream = Buffer.concat(some.map((v) => Buffer.from(v.hex, 'hex')));
      for (let step = 1; step <= 64; step++)
        assert.deepEqual(read(stream, from, step).map(({ h }) => h.type), some.map((v) => v.header.type));
    }
  });
  await check('every good body, cut short anywhere, is refused or is a shorter body', async () => {
    let refused = 0;
    for (const v of all.filter((x) => !x.error && x.body && schema.messages[bodyName(x.header.type)])) {
      const body = Buffer.from(v.hex, 'hex').subarray(24);
      for (let n = 0; n < body.length; n++)
        try {
          decode(schema, bodyName(v.header.type), body.subarray(0, n));
        } catch (error) {
          assert.ok(error instanceof BodyError, error.stack);
          refused++;
        }
    }
    assert.ok(refused > 100, `${refused} were refused`);
  });
  await check('random damage to bodies is refused as BAD_BODY, or is another body', async () => {
    const seed = Number(process.env.AIRY_SEED ?? 1);
    let state = seed >>> 0, refused = 0;
    const random = (n) => { state = (Math.imul(state, 1664525) + 1013904223) >>> 0; return Math.floor(state / 2 ** 32 * n); };
    const bodies = all.filter((x) => !x.error && x.body && schema.messages[bodyName(x.header.type)]);
    for (let i = 0; i < 8000; i++) {
      const v = bodies[random(bodies.length)], body = Buffer.from(Buffer.from(v.hex, 'hex').subarray(24));
      for (let k = random(3) + 1; k; k--)
        if (body.length)
          body[random(body.length)] = random(256);
      try {
        decode(schema, bodyName(v.header.type), body);
      } catch (error) {
        assert.ok(error instanceof BodyError, `seed ${seed}, round ${i}, ${v.name} ${body.toString('hex')}: ${error.stack}`);
        refused++;
      }
    }
    assert.ok(refused > 500 && refused < 7500, `${refused} of 8000 were refused`);
  });
  await check('a body of ten thousand empty sub-messages is refused before they are made', async () => {
    const bomb = Buffer.alloc(20_000, Buffer.from([0x12, 0x00]));
    assert.throws(() => decode(schema, 'Result', bomb), (e) => e instanceof BodyError && /more than 1048576 bytes/.test(e.message));
  });
  await check('64-bit numbers keep every bit, texts are Unicode without NUL', async () => {
    const most = 2n ** 64n - 1n;
    assert.equal(decode(schema, 'Credit', encode(schema, 'Credit', { bytes: most })).bytes, most);
    assert.equal(decode(schema, 'Target', encode(schema, 'Target', { minX: -2147483648 })).minX, -2147483648);
    for (const client of ['a\0b', '\ud800', 7])
      assert.throws(() => encode(schema, 'Hello', { client }), BodyError);
    for (const bytes of ['1a0161ff', '1a02c328', '1a0100'])
      assert.throws(() => decode(schema, 'Hello', Buffer.from(bytes, 'hex')), BodyError);
    assert.throws(() => encode(schema, 'Credit', { bytes: -1 }), /expected 0 to/);
    assert.throws(() => encode(schema, 'Bloom', { input: { kind: 'constructor' } }), /expected one of NONE INLINE/);
  });
  await check('unknown fields are passed over, an unknown enum keeps its number', async () => {
    assert.equal(decode(schema, 'Credit', Buffer.from('98060708' + '05' + 'a20601ff' + 'a9060000000000000000' + 'ad0600000000', 'hex')).bytes, 5n);
    assert.equal(decode(schema, 'Payload', Buffer.from('0863', 'hex')).kind, 0x63);
  });
}
