// SPDX-License-Identifier: Apache-2.0
// input.js - what callers say (typed arrays, an object of parameters, options) as the bodies of BLOOM and ASSET. What the daemon checks is
// left to it: its errors are the better ones, and the same from every language.
import { endianness } from 'node:os';
import { argument } from './errors.js';

const SAMPLES = { half: ['PIXEL_HALF', 2], float: ['PIXEL_FLOAT', 4], PIXEL_HALF: ['PIXEL_HALF', 2], PIXEL_FLOAT: ['PIXEL_FLOAT', 4],
  PIXEL_NONE: ['PIXEL_NONE', 4] };
// By name, for Float16Array is not there before Node 24.
const ARRAYS = { Float32Array: 'float', Uint16Array: 'half', Float16Array: 'half' };

/** Any buffer or view as bytes: the same memory. */
export function toBytes(input, field) {
  if (ArrayBuffer.isView(input))
    return Buffer.from(input.buffer, input.byteOffset, input.byteLength);
  if (input instanceof ArrayBuffer || input instanceof SharedArrayBuffer)
    return Buffer.from(input);
  throw argument(field, `${field} is ${input === null ? 'null' : typeof input}, expected a Buffer, ArrayBuffer or typed array`);
}

function channels(list, width, bytes) {
  const names = typeof list === 'string' ? [...list] : list;
  if (!Array.isArray(names) || !names.length)
    throw argument('raw.channels', `raw.channels is ${typeof list}, expected names in the order of a pixel's samples, or descriptions`);
  if (names.every((n) => typeof n === 'string'))
    return names.map((name, i) => ({ name, offset: i * bytes, rowStride: width * names.length * bytes, pixelStride: names.length * bytes }));
  return names;
}

function rawLayout(input, raw) {
  const own = ARRAYS[input.constructor.name];
  const sample = SAMPLES[raw.type ?? own];
  if (!sample || (own && raw.type && SAMPLES[own][0] !== sample[0] && raw.type !== 'PIXEL_NONE'))
    throw argument('raw.type', `raw.type is ${raw.type}, expected half or float${own ? `: the input is a ${input.constructor.name}` : ''}`);
  if (own && endianness() !== 'LE')
    throw argument('input', 'typed arrays are big-endian here, and the protocol is little-endian: send bytes with raw.type');
  const { width, height } = raw;
  return { width, height, type: sample[0], channels: channels(raw.channels ?? 'RGB', width, sample[1]) };
}

/** The parameters of section 9 as the protocol has them: numbers, or texts. undefined and null are left out. */
export function toParams(params = {}) {
  return Object.entries(params).filter(([, v]) => v !== undefined && v !== null).map(([name, value]) => {
    if (typeof value === 'number' && !Number.isFinite(value))
      throw argument(`params.${name}`, `params.${name} is ${value}, expected a finite number`);
    if (typeof value !== 'number' && typeof value !== 'string')
      throw argument(`params.${name}`, `params.${name} is ${typeof value}, expected a number or a text`);
    return typeof value === 'number' ? { name, number: value } : { name, text: value };
  });
}

/** What Connection.request takes, but for the caller's hooks. */
export function toBloom(input, params, { exr, raw, progress, plan, wall, show, presentNs, partOf, priority, deadlineMs }) {
  const bytes = toBytes(input, 'input');
  if (exr && raw)
    throw argument('raw', 'exr and raw are both given, expected one of them');
  if (!raw && ARRAYS[input.constructor.name])
    throw argument('raw', `the input is a ${input.constructor.name}, expected raw: { width, height, channels } with it`);
  if (!wall)
    for (const [field, given] of Object.entries({ show, presentNs, partOf }))
      if (given !== undefined && given !== false)
        throw argument(field, `${field} is given without wall, expected the name of an open wall with it`);
  if (wall !== undefined && (typeof wall !== 'string' || !wall))
    throw argument('wall', `wall is ${wall === '' ? 'empty' : typeof wall}, expected the name of an open wall`);
  const format = raw ? { raw: rawLayout(input, raw) } : exr ? { exr } : {};
  return {
    type: 'BLOOM',
    input: bytes,
    output: !plan && !show,
    once: Boolean(show), // its time will have gone
    ...(raw && !plan && !wall && { expectBytes: bytes.byteLength }),
    body: {
      params: toParams(params),
      input: { kind: 'INLINE', size: bytes.byteLength },
      ...format,
      output: { kind: show ? 'WALL' : 'INLINE' },
      progress,
      planOnly: plan,
      ...(wall && { wall: { name: wall, presentNs, ...partOf } }),
      priority,
      deadlineMs,
    },
  };
}

/** A wall's linear drive, R G B of each pixel, as it came: little-endian floats. */
export function toDrive(bytes) {
  const out = new Float32Array(bytes.byteLength / 4), own = Buffer.from(out.buffer);
  own.set(bytes);
  if (endianness() !== 'LE')
    own.swap32();
  return out;
}

/** The output as the caller's own kind of array. */
export function likeInput(input, output) {
  const own = ARRAYS[input.constructor.name];
  if (!own || !output)
    return output;
  const { BYTES_PER_ELEMENT } = input.constructor;
  return new input.constructor(output.buffer, output.byteOffset, output.byteLength / BYTES_PER_ELEMENT);
}
