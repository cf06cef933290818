// SPDX-License-Identifier: Apache-2.0
// generate.mjs - makes gen/ from the contract: message tables and types from airy.proto (read by protoc), the tables of message types,
// errors and parameters from PROTOCOL.md, which the daemon's tests hold to the code. So nothing of it is written twice.
//
//     node generate.mjs [FOLDER]      writes FOLDER/gen (default: the package itself); needs Debian's protobuf-compiler
//
// PROTOC names another protoc. Users of the package need neither: gen/ is in it.
import { execFileSync } from 'node:child_process';
import { copyFileSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { dirname, join } from 'node:path';
import { fileURLToPath } from 'node:url';
import { decode, FIELD_TYPES } from './lib/protobuf.js';

const here = dirname(fileURLToPath(import.meta.url));
const proto = join(here, '../../proto'), out = join(process.argv[2] ?? here, 'gen');

// ---- airy.proto -----------------------------------------------------------------------------------

// What is read of descriptor.proto, the form in which protoc hands a file on; its numbers are fixed for ever.
const f = (number, name, type, more) => ({ number, name, type, ...more });
const many = (of) => ({ repeated: true, of });
const DESCRIPTOR = {
  enums: {},
  messages: {
    FileDescriptorSet: [f(1, 'file', 'message', many('FileDescriptorProto'))],
    FileDescriptorProto: [
      f(2, 'package', 'string'), f(4, 'messageType', 'message', many('DescriptorProto')),
      f(5, 'enumType', 'message', many('EnumDescriptorProto')), f(9, 'sourceCodeInfo', 'message', { of: 'SourceCodeInfo' }),
      f(12, 'syntax', 'string'),
    ],
    DescriptorProto: [
      f(1, 'name', 'string'), f(2, 'field', 'message', many('FieldDescriptorProto')),
      f(3, 'nestedType', 'message', many('DescriptorProto')), f(4, 'enumType', 'message', many('EnumDescriptorProto')),
    ],
    FieldDescriptorProto: [
      f(1, 'name', 'string'), f(3, 'number', 'int32'), f(4, 'label', 'int32'), f(5, 'type', 'int32'), f(6, 'typeName', 'string'),
      f(9, 'oneofIndex', 'int32', { oneof: 'present' }), f(10, 'jsonName', 'string'),
    ],
    EnumDescriptorProto: [f(1, 'name', 'string'), f(2, 'value', 'message', many('EnumValueDescriptorProto'))],
    EnumValueDescriptorProto: [f(1, 'name', 'string'), f(2, 'number', 'int32')],
    SourceCodeInfo: [f(1, 'location', 'message', many('Location'))],
    Location: [f(1, 'path', 'int32', { repeated: true }), f(3, 'leading', 'string'), f(4, 'trailing', 'string')],
  },
};
const TYPES = { 1: 'double', 2: 'float', 3: 'int64', 4: 'uint64', 5: 'int32', 8: 'bool', 9: 'string', 11: 'message', 12: 'bytes',
  13: 'uint32', 14: 'enum' };
const REPEATED = 3;

function compile() {
  const folder = mkdtempSync(join(tmpdir(), 'airy-node-'));
  try {
    const file = join(folder, 'airy.desc');
    execFileSync(process.env.PROTOC ?? 'protoc',
      [`--proto_path=${proto}`, '--include_source_info', `--descriptor_set_out=${file}`, 'airy.proto'], { stdio: 'inherit' });
    return decode(DESCRIPTOR, 'FileDescriptorSet', readFileSync(file), 64 * 1024 * 1024).file[0];
  } finally {
    rmSync(folder, { recursive: true });
  }
}

const local = (file, typeName) => typeName.slice(file.package.length + 2);

function schemaOf(file) {
  const schema = { messages: {}, enums: {} }, comments = {};
  const said = new Map(file.sourceCodeInfo.location.map((l) => [l.path.join(), (l.trailing || l.leading).trim()]));
  const addEnum = (e, prefix) => {
    schema.enums[prefix + e.name] = Object.fromEntries(e.value.map((v) => [v.name, v.number]));
  };
  const addMessage = (m, prefix, path) => {
    const name = prefix + m.name;
    schema.messages[name] = m.field.map((d, i) => {
      const type = TYPES[d.type];
      if (!FIELD_TYPES.includes(type))
        throw new Error(`${name}.${d.name} has type ${d.type}, which lib/protobuf.js does not know`);
      comments[`${name}.${d.jsonName}`] = said.get([...path, 2, i].join()) ?? '';
      return { number: d.number, name: d.jsonName, type, ...(d.label === REPEATED && { repeated: true }),
        ...(d.oneofIndex !== undefined && { oneof: `oneof${d.oneofIndex}` }), ...(d.typeName && { of: local(file, d.typeName) }) };
    }).sort((a, b) => a.number - b.number);
    comments[name] = said.get(path.join()) ?? '';
    m.enumType.forEach((e) => addEnum(e, `${name}.`));
    m.nestedType.forEach((n, i) => addMessage(n, `${name}.`, [...path, 3, i]));
  };
  file.enumType.forEach((e) => addEnum(e, ''));
  file.messageType.forEach((m, i) => addMessage(m, '', [4, i]));
  return { schema, comments };
}

// ---- PROTOCOL.md ------------------------------------------------------------------------------------

function table(document, name, columns) {
  const found = document.match(new RegExp(`<!-- ${name} -->\\n([^]*?)<!-- /${name} -->`));
  const rows = found?.[1].trim().split('\n').map((line) => line.split('|').slice(1, -1).map((cell) => cell.trim()));
  if (!rows || rows.length < 3 || rows[0].length !== columns)
    throw new Error(`PROTOCOL.md has no table "${name}" of ${columns} columns`);
  return rows.slice(2);
}

// ---- what is written ---------------------------------------------------------------------------------

const HEAD = '// SPDX-License-Identifier: Apache-2.0\n// Made by generate.mjs from airy.proto and PROTOCOL.md: not to be edited.\n';
const flat = (name) => name.replace('.', '');
const doc = (comment, indent) => (comment ? `${indent}/** ${comment.replace(/\s+/g, ' ').replaceAll('*/', '* /')} */\n` : '');
const TS = { double: 'number', float: 'number', int64: 'bigint', uint64: 'bigint', int32: 'number', uint32: 'number', bool: 'boolean',
  string: 'string', bytes: 'Buffer' };

function typeText(field) {
  const one = field.type === 'message' ? flat(field.of) : field.type === 'enum' ? `${flat(field.of)} | number` : TS[field.type];
  if (field.repeated)
    return field.type === 'enum' ? `(${one})[]` : `${one}[]`;
  return field.oneof ? `${one} | undefined` : field.type === 'message' ? `${one} | null` : one;
}

function messageTypes({ schema, comments }) {
  const enums = Object.entries(schema.enums).map(([name, values]) =>
    `export type ${flat(name)} = ${Object.keys(values).map((v) => `'${v}'`).join(' | ')};\n`);
  const messages = Object.entries(schema.messages).map(([name, fields]) =>
    `${doc(comments[name], '')}export interface ${flat(name)} {\n${fields.map((field) =>
      `${doc(comments[`${name}.${field.name}`], '  ')}  ${field.name}: ${typeText(field)};\n`).join('')}}\n`);
  return `${HEAD}\n${enums.join('')}\n${messages.join('\n')}`;
}

function paramTypes(rows) {
  const words = (text) => text.split(' ').map((w) => (/^[\d.]+$/.test(w) ? `'${w}' | ${w}` : `'${w}'`)).join(' | ');
  const fields = rows.map(([name, type, preset, range, unit, meaning]) => {
    const facts = [unit, preset && `default ${preset}`, type === 'number' && range].filter(Boolean).join('; ');
    return `${doc(`${meaning}${facts ? ` (${facts})` : ''}`, '  ')}  ${name}?: ${
      type === 'choice' ? words(range) : type === 'number' ? 'number | string' : 'string | number'};\n`;
  });
  return `${HEAD}\n/** The parameters of section 9 of PROTOCOL.md, by name. */\nexport interface Params {\n${fields.join('')}}\n`;
}

const document = readFileSync(join(proto, 'PROTOCOL.md'), 'utf8');
const sides = { client: ['client'], daemon: ['daemon'], both: ['client', 'daemon'] };
const types = table(document, 'types', 6).map(([number, name, by, fds]) => ({ number: Number(number), name, by: sides[by], fds: Number(fds) }));
const faults = table(document, 'faults', 5).map(([code, symbol, retryable, closes, meaning]) =>
  ({ code: Number(code), symbol, retryable: retryable === 'yes', closes: closes === 'yes', meaning }));
const params = table(document, 'params', 6);
const made = schemaOf(compile());

mkdirSync(out, { recursive: true });
const json = (value) => JSON.stringify(value, null, 1);
writeFileSync(join(out, 'contract.js'), `${HEAD}
export const schema = ${json(made.schema)};
export const types = ${json(types)};
export const faults = ${json(faults)};
export const params = ${json(params.map((p) => p[0]))};
`);
writeFileSync(join(out, 'messages.d.ts'), messageTypes(made));
writeFileSync(join(out, 'params.d.ts'), paramTypes(params));
writeFileSync(join(out, 'symbols.d.ts'), `${HEAD}
/** The errors of section 8 of PROTOCOL.md. */
export type FaultSymbol = ${faults.map((x) => `'${x.symbol}'`).join(' | ')};
`);
copyFileSync(join(proto, 'airy.proto'), join(out, 'airy.proto'));
copyFileSync(join(here, '../../LICENSE'), join(out, 'LICENSE'));
