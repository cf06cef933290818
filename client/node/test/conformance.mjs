// SPDX-License-Identifier: Apache-2.0
// conformance.mjs - runs tests/conformance/cases.json, whose format its README.md tells, against live daemons. Node's sockets carry no
// descriptors: the ways and cases that need them are counted, and said to be skipped.
import assert from 'node:assert/strict';
import { existsSync, readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { schema } from '../gen/contract.js';
import { connect } from '../lib/index.js';
import { bodyName } from '../lib/frame.js';
import { check, commandBytes, Peer, rejects, root, scene, skip, sparks, startDaemon, stopDaemon, toJson, work } from './kit.mjs';

const MIB = 1 << 20;
const PASSING = ['CREDIT', 'PROGRESS', 'DATA'];

async function makePayloads(described) {
  const made = {};
  for (const [name, p] of Object.entries(described)) {
    const bytes = p.hex !== undefined ? Buffer.from(p.hex, 'hex') : p.scene ? (await scene(...p.scene)).bytes
      : p.raw ? Buffer.from(sparks(p.raw).buffer) : made[p.of].bytes.subarray(0, p.bytes);
    const file = join(work, `payload-${name}`);
    writeFileSync(file, bytes);
    made[name] = { bytes, file, raw: p.raw };
  }
  return made;
}

const optionsOf = ({ exr, raw }, payload) =>
  (raw ?? payload.raw ? { raw: raw ?? { ...payload.raw, channels: payload.raw.channels } } : exr ? { exr } : {});

async function blooms(airy, daemon, request, expect, payload, outputs, name) {
  const seen = [];
  const options = { ...optionsOf(request, payload), ...(request.progress && { onProgress: (p) => seen.push(p) }) };
  const asked = request.plan_only ? airy.plan(payload.bytes, request.params, options) : airy.bloom(payload.bytes, request.params, options);
  if (expect.error)
    return rejects(asked, expect.error);
  const result = await asked, [first] = result.targets;
  if (!request.plan_only) {
    outputs.set(name, result.output);
    assert.ok(first.plan.length > 0 && result.ms.total > 0);
  }
  const holds = {
    exr: () => assert.equal(result.output.subarray(0, 4).toString('hex'), '762f3101'),
    targets: (n) => assert.equal(result.targets.length, n),
    untouched: (b) => assert.equal(first.untouched, b),
    nan: (n) => assert.equal(first.nonfinite.nan, BigInt(n)),
    same_as_input: () => assert.ok(result.output.equals(payload.bytes)),
    size_of_input: () => assert.ok(result.output.length === payload.bytes.length && !result.output.equals(payload.bytes)),
    same_by_every_way: () => {}, // there is one way
    as: (other) => assert.ok(result.output.equals(outputs.get(other)), `not the bytes of "${other}"`),
    command: async (args) => assert.ok(result.output.equals(await commandBytes(daemon, payload.file, args)), 'not the command\'s bytes'),
    plan: () => assert.ok(result.output === null && first.plan.length > 0 && first.errorBound > 0 && first.predictedMs > 0),
    progress: () => {
      assert.ok(seen.length > 0);
      assert.ok(seen.every((p, i) => p.fraction >= (seen[i - 1]?.fraction ?? 0) && p.fraction <= 1), JSON.stringify(seen));
    },
  };
  for (const [key, value] of Object.entries(expect)) {
    assert.ok(holds[key], `this runner does not know "${key}"`);
    if (value !== false || key === 'untouched')
      await holds[key](value);
  }
}

// ---- walls --------------------------------------------------------------------------------------------------

function states(found, wanted) {
  assert.equal(found.length, wanted.length, JSON.stringify(found.map((w) => w.name)));
  for (const [i, fields] of wanted.entries())
    for (const [name, value] of Object.entries(fields)) {
      if (name === 'boards')
        states(found[i].boards, value);
      else
        assert.equal(typeof found[i][name] === 'bigint' ? Number(found[i][name]) : found[i][name], value, `${name} of ${found[i].name}`);
    }
}

function previewed({ data, wall }, { pixels, first }) {
  assert.equal(data.length, wall.width * wall.height * 3);
  if (pixels)
    assert.ok(data.every((v) => pixels.includes(v)), `the preview has ${[...new Set(data)].slice(0, 8)}`);
  if (first)
    assert.deepEqual([...data.subarray(0, 3)], first);
}

function driven(result, { drive, need }) {
  if (need)
    assert.deepEqual([result.need.x, result.need.y, result.need.width, result.need.height], need);
  if (!drive)
    return;
  const { width, height, value, lit = [0, 0, width, height] } = drive;
  assert.deepEqual([result.width, result.height, result.output.length], [width, height, width * height * 3]);
  assert.ok(result.output instanceof Float32Array && result.output.every((v) => Number.isFinite(v) && v >= 0));
  if (value !== undefined)
    for (const [i, v] of result.output.entries()) {
      const x = Math.floor(i / 3) % width, y = Math.floor(i / 3 / width);
      const inside = x >= lit[0] && x < lit[0] + lit[2] && y >= lit[1] && y < lit[1] + lit[3];
      assert.ok(Math.abs(v - (inside ? value : 0)) <= 1e-4, `sample ${i} is ${v}`);
    }
}

async function patiently(check, patienceMs) {
  for (const end = performance.now() + patienceMs; ;)
    try {
      return await check();
    } catch (error) {
      if (error.code !== 'ERR_ASSERTION' || performance.now() >= end)
        throw error;
      await new Promise((resolve) => setTimeout(resolve, 20));
    }
}

function wallBloom(airy, what, payloads, show) {
  const { wall, params, priority, deadline_ms: deadlineMs, plan_only: plan } = what, payload = payloads[what.input];
  const part = wall?.part_of && Object.fromEntries(['frameWidth', 'frameHeight', 'x', 'y'].map((name, i) => [name, wall.part_of[i]]));
  const options = { ...optionsOf(what, payload), wall: wall?.name, partOf: part, priority, deadlineMs, ...(show && { show, presentNs: wall.present_ns }) };
  return plan ? airy.plan(payload.bytes, params, options) : airy.bloom(payload.bytes, params, options);
}

async function wallStep(airy, step, payloads) {
  const { expect = {} } = step, verb = ['open', 'close', 'list', 'pattern', 'preview', 'bloom', 'show'].find((v) => v in step), what = step[verb];
  const does = {
    open: async () => [await airy.wallOpen(what.definition, what)],
    close: () => airy.wallClose(what),
    list: async () => (await airy.wallList(what)).walls,
    pattern: async () => [await airy.wallPattern(what.name, what.pattern, what)],
    preview: () => airy.wallPreview(what),
    bloom: () => wallBloom(airy, what, payloads, false),
    show: () => wallBloom(airy, what, payloads, true),
  }[verb];
  if (expect.error)
    return rejects(does(), expect.error);
  const holds = { preview: previewed, bloom: driven, show: driven, close: () => {} }[verb] ?? ((found) => states(found, expect.walls));
  await patiently(async () => holds(await does(), expect), ['list', 'preview'].includes(verb) ? 30_000 : 0);
}

async function walls(daemon, steps, payloads) {
  const clients = new Map();
  try {
    for (const step of steps) {
      const name = step.leave ?? step.as ?? 'a';
      if (!clients.has(name))
        clients.set(name, await connect({ path: daemon.path }));
      if (step.leave)
        clients.get(name).close();
      else if (!(step.bloom ?? step.show) || (step.bloom ?? step.show).via.includes('inline'))
        await wallStep(clients.get(name), { ...step, ...(step.bloom && { bloom: { ...step.bloom, output: undefined } }) }, payloads);
    }
  } finally {
    clients.forEach((airy) => airy.close());
  }
}

// ---- bare sessions ---------------------------------------------------------------------------------------

const fill = (value, payloads) => JSON.parse(JSON.stringify(value ?? null), (_, v) =>
  (typeof v === 'string' && v.startsWith('$SIZE:') ? String(payloads[v.slice(6)].bytes.length) : v));

function send(peer, step, payloads) {
  if (step.vector)
    return peer.socket.write(Buffer.from(JSON.parse(readFileSync(join(root, `proto/vectors/${step.vector}.json`), 'utf8')).hex, 'hex'));
  const id = BigInt(step.id ?? 0);
  if (step.type !== 'DATA')
    return peer.send(step.type, id, fill(step.body, payloads), step.n_fds ?? 0);
  const bytes = payloads[step.payload].bytes.subarray(step.begin, step.end);
  for (let at = 0; at < bytes.length || at === 0; at += MIB)
    peer.send('DATA', id, bytes.subarray(at, at + MIB));
}

async function expectMessage(peer, wanted) {
  const message = await peer.next(PASSING.filter((t) => t !== wanted.type));
  if (wanted === 'close')
    return assert.equal(message, null);
  assert.ok(message, `the connection was closed, expected ${wanted.type}`);
  const known = schema.messages[bodyName(message.type)], body = known ? toJson(bodyName(message.type), message.body) : {};
  assert.equal(message.type, wanted.type, JSON.stringify(body));
  if (wanted.id !== undefined)
    assert.equal(message.id, BigInt(wanted.id));
  for (const [key, value] of Object.entries(wanted.body ?? {}))
    assert.deepEqual(body[key], value, `${key} of ${JSON.stringify(body)}`);
}

async function expectCredit(peer, wanted, payloads) {
  const [, name, times] = wanted.match(/^\$SIZE:(\w+)\*(\d+)$/);
  const most = payloads[name].bytes.length * Number(times);
  const sum = () => peer.received.filter((m) => m.type === 'CREDIT').reduce((s, m) => s + Number(m.body.bytes), 0);
  // STATUS is answered after whatever came before it: no more credit is then to come.
  for (let id = 1000n; sum() < most; id++) {
    peer.send('STATUS', id);
    const reply = await peer.next(PASSING);
    assert.equal(reply?.type, 'STATUS_REPLY');
  }
  assert.equal(sum(), most);
}

async function session(daemon, steps, payloads) {
  const peer = await Peer.connect(daemon.path);
  try {
    for (const step of steps) {
      if (step.send)
        send(peer, step.send, payloads);
      else if (step.expect)
        await expectMessage(peer, step.expect);
      else
        await expectCredit(peer, step.credit, payloads);
    }
  } finally {
    peer.socket.destroy();
  }
}

// ---- all of them --------------------------------------------------------------------------------------------

async function kept(airy, daemon, one, payloads, outputs) {
  const payload = payloads[one.asset.input];
  if (one.expect.error)
    return rejects(airy.asset(payload.bytes), one.expect.error);
  const { digest, ...size } = await airy.asset(payload.bytes);
  assert.match(digest, /^[0-9a-f]{32}$/);
  assert.deepEqual(size, one.expect.kept);
  assert.equal((await airy.asset(payload.bytes)).digest, digest);
  const then = JSON.parse(JSON.stringify(one.then).replaceAll('$DIGEST', digest));
  await blooms(airy, daemon, then.request, then.expect, payloads[then.request.input], outputs, one.name);
}

export async function conformance() {
  const file = process.env.AIRY_CASES ?? join(root, 'tests/conformance/cases.json');
  if (!existsSync(file))
    return skip('the conformance suite', 'tests/conformance/cases.json is not there');
  const { daemons, payloads: described, cases } = JSON.parse(readFileSync(file, 'utf8'));
  const payloads = await makePayloads(described), outputs = new Map(), running = {}, clients = {};
  const left = { memfd: [], file: [], 'output into a memfd or buffer': [], 'sessions with descriptors': [] };
  for (const [name, options] of Object.entries(daemons)) {
    running[name] = await startDaemon(options);
    clients[name] = await connect({ path: running[name].path, busyRetries: 0 });
  }
  for (const one of cases) {
    const daemon = running[one.daemon], airy = clients[one.daemon], asked = one.request ?? one.asset;
    if (one.session && (one.needs === 'fd' || one.session.some((s) => s.send?.fds)))
      left['sessions with descriptors'].push(one.name);
    else if (one.walls)
      await check(`conformance: ${one.name}`, () => walls(daemon, one.walls, payloads));
    else if (one.session)
      await check(`conformance: ${one.name}`, () => session(daemon, one.session, payloads));
    else {
      for (const way of asked.via.filter((w) => w !== 'inline'))
        left[way].push(one.name);
      if ((asked.output ?? 'inline') !== 'inline')
        left['output into a memfd or buffer'].push(one.name);
      else if (one.asset)
        await check(`conformance: ${one.name}`, () => kept(airy, daemon, one, payloads, outputs));
      else if (asked.via.includes('inline'))
        await check(`conformance: ${one.name}`, () => blooms(airy, daemon, asked, one.expect, payloads[asked.input], outputs, one.name));
    }
  }
  for (const [way, names] of Object.entries(left))
    if (names.length)
      skip(`conformance: ${way}, ${names.length} cases`, 'sockets of Node carry no descriptors');
  for (const name of Object.keys(running)) {
    clients[name].close();
    await stopDaemon(running[name]);
  }
}
