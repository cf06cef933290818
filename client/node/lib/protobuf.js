// SPDX-License-Identifier: Apache-2.0
// protobuf.js - encodes and decodes the bodies of messages by tables that generate.mjs makes from airy.proto.
//
// A codec of our own, because Debian 12 has no protobuf runtime for Node, the tests must run without a network, and what a peer sends
// must be refused by this project's rules: texts are UTF-8 without NUL, damaged bodies are BAD_BODY, and a body that would decode to
// more than 1 MiB is refused before it does. 64-bit fields are bigint, absent messages null, absent members of a oneof undefined.
//
// A schema is { messages: { Name: [field...] }, enums: { Name: { VALUE: number } } }, a field
// { number, name, type, repeated?, oneof?, of? }: `of` names the message or enum.

const DECODED_BYTES_MAX = 1024 * 1024;
const DEPTH_MAX = 16;
const VARINT = 0, FIXED64 = 1, BYTES = 2, FIXED32 = 5;
const WIRE = {
  uint32: VARINT, int32: VARINT, uint64: VARINT, int64: VARINT, bool: VARINT, enum: VARINT,
  double: FIXED64, float: FIXED32, string: BYTES, bytes: BYTES, message: BYTES,
};

/** The types of fields that this codec knows; the generator refuses others. */
export const FIELD_TYPES = Object.keys(WIRE);

/** A body that is not what its message says; `field` names where. */
export class BodyError extends Error {
  constructor(field, text) {
    super(text);
    this.name = 'BodyError';
    this.field = field;
  }
}

// ---- encode ---------------------------------------------------------------------------------------

function varint(value) {
  let v = BigInt.asUintN(64, value);
  const out = [];
  while (v > 127n) {
    out.push(Number(v & 127n) | 128);
    v >>= 7n;
  }
  out.push(Number(v));
  return Buffer.from(out);
}

const INTEGERS = {
  uint32: [0n, 2n ** 32n - 1n], int32: [-(2n ** 31n), 2n ** 31n - 1n],
  uint64: [0n, 2n ** 64n - 1n], int64: [-(2n ** 63n), 2n ** 63n - 1n],
};

function integer(type, value, where) {
  const [least, most] = INTEGERS[type];
  let v;
  try {
    v = BigInt(value);
  } catch {
    throw new BodyError(where, `${where} is ${String(value)}, expected a whole number`);
  }
  if (v < least || v > most)
    throw new BodyError(where, `${where} is ${v}, expected ${least} to ${most}`);
  return v;
}

function text(value, where) {
  if (typeof value !== 'string')
    throw new BodyError(where, `${where} is ${typeof value}, expected a text`);
  if (value.includes('\0'))
    throw new BodyError(where, `${where} holds a NUL character, which no text may`);
  if (/[\ud800-\udbff](?![\udc00-\udfff])|(?<![\ud800-\udbff])[\udc00-\udfff]/.test(value))
    throw new BodyError(where, `${where} holds half a surrogate pair, expected Unicode text`);
  return Buffer.from(value, 'utf8');
}

function enumNumber(schema, field, value, where) {
  if (typeof value === 'number')
    return integer('int32', value, where);
  const number = schema.enums[field.of][value];
  if (!Object.hasOwn(schema.enums[field.of], value))
    throw new BodyError(where, `${where} is ${String(value)}, expected one of ${Object.keys(schema.enums[field.of]).join(' ')}`);
  return BigInt(number);
}

// The bytes of one value without its key, or null where proto3 leaves a default out.
function valueBytes(schema, field, value, where, keepDefault) {
  const { type } = field;
  if (type === 'message') {
    const body = encode(schema, field.of, value, where);
    return Buffer.concat([varint(BigInt(body.length)), body]);
  }
  if (type === 'string' || type === 'bytes') {
    const bytes = type === 'string' ? text(value, where) : Buffer.from(value);
    return bytes.length || keepDefault ? Buffer.concat([varint(BigInt(bytes.length)), bytes]) : null;
  }
  if (type === 'double' || type === 'float') {
    const number = Number(value);
    if (number === 0 && !Object.is(number, -0) && !keepDefault)
      return null;
    const out = Buffer.alloc(type === 'double' ? 8 : 4);
    type === 'double' ? out.writeDoubleLE(number) : out.writeFloatLE(number);
    return out;
  }
  const number = type === 'bool' ? BigInt(Boolean(value))
    : type === 'enum' ? enumNumber(schema, field, value, where) : integer(type, value, where);
  return number !== 0n || keepDefault ? varint(number) : null;
}

/** The bytes of message `name`; fields in order of their numbers, defaults left out. */
export function encode(schema, name, message, where = name) {
  const parts = [];
  for (const field of schema.messages[name]) {
    const value = message[field.name];
    if (value === undefined || value === null)
      continue;
    const wire = WIRE[field.type];
    if (field.repeated && wire !== BYTES) { // numbers go packed, as proto3 has it
      const all = value.map((one, i) => valueBytes(schema, field, one, `${where}.${field.name}[${i}]`, true));
      const body = Buffer.concat(all);
      if (all.length)
        parts.push(varint(BigInt(field.number * 8 + BYTES)), varint(BigInt(body.length)), body);
      continue;
    }
    const key = varint(BigInt(field.number * 8 + wire));
    for (const [i, one] of (field.repeated ? value : [value]).entries()) {
      const at = `${where}.${field.name}${field.repeated ? `[${i}]` : ''}`;
      const bytes = valueBytes(schema, field, one, at, field.repeated || field.oneof);
      if (bytes)
        parts.push(key, bytes);
    }
  }
  return Buffer.concat(parts);
}

// ---- decode ---------------------------------------------------------------------------------------

const utf8 = new TextDecoder('utf-8', { fatal: true, ignoreBOM: true });

class Cursor {
  constructor(bytes, budget) {
    this.bytes = bytes;
    this.at = 0;
    this.end = bytes.length;
    this.budget = budget;
  }

  spend(bytes, where) {
    this.budget.left -= bytes;
    if (this.budget.left < 0)
      throw new BodyError(where, `${where} decodes to more than ${DECODED_BYTES_MAX} bytes of memory`);
  }

  varint(where) {
    // Most are small: no bigint for those.
    let low = 0;
    for (let i = 0; i < 4; i++) {
      if (this.at >= this.end)
        throw new BodyError(where, `${where} ends within a number`);
      const b = this.bytes[this.at++];
      low += (b & 127) * 2 ** (7 * i);
      if (b < 128)
        return BigInt(low);
    }
    let value = BigInt(low);
    for (let i = 4; i < 10; i++) {
      if (this.at >= this.end)
        throw new BodyError(where, `${where} ends within a number`);
      const b = this.bytes[this.at++];
      value |= BigInt(b & 127) << BigInt(7 * i);
      if (b < 128)
        return BigInt.asUintN(64, value);
    }
    throw new BodyError(where, `${where} holds a number of more than 10 bytes`);
  }

  take(length, where) {
    if (length > this.end - this.at)
      throw new BodyError(where, `${where} states ${length} bytes, ${this.end - this.at} are left`);
    this.at += length;
    return this.bytes.subarray(this.at - length, this.at);
  }

  block(where) {
    const length = this.varint(where);
    if (length > BigInt(this.end - this.at))
      throw new BodyError(where, `${where} states ${length} bytes, ${this.end - this.at} are left`);
    return this.take(Number(length), where);
  }

  skip(wire, where) {
    if (wire === VARINT)
      this.varint(where);
    else if (wire === FIXED64)
      this.take(8, where);
    else if (wire === BYTES)
      this.block(where);
    else if (wire === FIXED32)
      this.take(4, where);
    else
      throw new BodyError(where, `${where} has wire type ${wire}, expected 0, 1, 2 or 5`);
  }
}

function readText(bytes, where) {
  let value;
  try {
    value = utf8.decode(bytes);
  } catch {
    throw new BodyError(where, `${where} is not UTF-8`);
  }
  if (value.includes('\0'))
    throw new BodyError(where, `${where} holds a NUL character, which no text may`);
  return value;
}

function readScalar(schema, field, cursor, where) {
  switch (field.type) {
    case 'double': return cursor.take(8, where).readDoubleLE(0);
    case 'float': return cursor.take(4, where).readFloatLE(0);
    case 'uint64': return cursor.varint(where);
    case 'int64': return BigInt.asIntN(64, cursor.varint(where));
    case 'uint32': return Number(BigInt.asUintN(32, cursor.varint(where)));
    case 'int32': return Number(BigInt.asIntN(32, cursor.varint(where)));
    case 'bool': return cursor.varint(where) !== 0n;
    case 'enum': {
      const number = Number(BigInt.asIntN(32, cursor.varint(where)));
      const values = schema.enums[field.of];
      return Object.keys(values).find((name) => values[name] === number) ?? number;
    }
    default: {
      const bytes = cursor.block(where);
      cursor.spend(32 + 2 * bytes.length, where);
      return field.type === 'string' ? readText(bytes, where) : Buffer.from(bytes);
    }
  }
}

const EMPTY = {
  double: 0, float: 0, uint64: 0n, int64: 0n, uint32: 0, int32: 0, bool: false, string: '', message: null,
};

function empty(schema, name) {
  const out = {};
  for (const f of schema.messages[name])
    out[f.name] = f.repeated ? [] : f.oneof ? undefined : f.type === 'bytes' ? Buffer.alloc(0)
      : f.type === 'enum' ? Object.keys(schema.enums[f.of]).find((k) => schema.enums[f.of][k] === 0) : EMPTY[f.type];
  return out;
}

function readInto(out, schema, name, cursor, where, depth) {
  if (depth > DEPTH_MAX)
    throw new BodyError(where, `${where} is nested more than ${DEPTH_MAX} deep`);
  const fields = schema.messages[name];
  while (cursor.at < cursor.end) {
    const key = cursor.varint(where);
    const number = key >> 3n, wire = Number(key & 7n);
    if (number === 0n || number > 536870911n)
      throw new BodyError(where, `${where} holds field number ${number}, expected 1 to 536870911`);
    const field = fields.find((f) => f.number === Number(number));
    if (!field) {
      cursor.skip(wire, where);
      continue;
    }
    const at = `${where}.${field.name}`;
    if (wire === BYTES && field.repeated && WIRE[field.type] !== BYTES) {
      const packed = new Cursor(cursor.block(at), cursor.budget);
      while (packed.at < packed.end) {
        packed.spend(16, at);
        out[field.name].push(readScalar(schema, field, packed, at));
      }
      continue;
    }
    if (wire !== WIRE[field.type])
      throw new BodyError(at, `${at} has wire type ${wire}, expected ${WIRE[field.type]}`);
    let value;
    if (field.type === 'message') {
      const old = field.repeated ? null : out[field.name];
      if (!old)
        cursor.spend(64 + 16 * schema.messages[field.of].length, at);
      value = readInto(old ?? empty(schema, field.of), schema, field.of, new Cursor(cursor.block(at), cursor.budget), at, depth + 1);
    } else {
      cursor.spend(field.repeated ? 16 : 0, at);
      value = readScalar(schema, field, cursor, at);
    }
    if (field.repeated) {
      out[field.name].push(value);
      continue;
    }
    if (field.oneof)
      for (const other of fields)
        if (other.oneof === field.oneof && other !== field)
          out[other.name] = undefined;
    out[field.name] = value;
  }
  return out;
}

/** The message in `bytes`, every field set; BodyError where it cannot be one. */
export function decode(schema, name, bytes, budgetBytes = DECODED_BYTES_MAX) {
  const buffer = Buffer.from(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  return readInto(empty(schema, name), schema, name, new Cursor(buffer, { left: budgetBytes }), name, 0);
}
