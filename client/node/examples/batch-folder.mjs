#!/usr/bin/env node
// SPDX-License-Identifier: Apache-2.0
// batch-folder.mjs - blooms every EXR of a folder, eight in flight, with a line of progress: batch-folder.mjs FROM TO [NAME=VALUE...]
//
// What is in TO already is left out, so it can be started again; a bad frame is said, and costs one frame: the exit status is then 1.
import { existsSync, readdirSync } from 'node:fs';
import { readFile, rename, writeFile } from 'node:fs/promises';
import { join } from 'node:path';
import { connect } from '@airyd/client';

const [from, to, ...settings] = process.argv.slice(2);
const params = Object.fromEntries(settings.map((s) => s.split(/=(.*)/s).slice(0, 2)));
const todo = readdirSync(from).filter((name) => name.endsWith('.exr') && !existsSync(join(to, name))).sort();
const airy = await connect(), began = performance.now();
let next = 0, done = 0, failed = 0;

async function work() {
  while (next < todo.length) {
    const name = todo[next++], part = join(to, `.${name}.part`);
    try {
      const { output } = await airy.bloom(await readFile(join(from, name)), params);
      await writeFile(part, output);
      await rename(part, join(to, name));
    } catch (error) {
      failed++;
      console.error(`\r\x1b[K${name}: ${error.message}`);
    }
    const rate = ++done / Math.max((performance.now() - began) / 1000, 1e-3);
    process.stderr.write(`\r\x1b[K${done}/${todo.length}  ${rate.toFixed(1)} frames/s  ${((todo.length - done) / rate).toFixed(0)} s left`);
  }
}

await Promise.all(Array.from({ length: 8 }, work));
console.error(`\n${done - failed} of ${todo.length} frames bloomed`);
process.exitCode = failed ? 1 : 0;
airy.close();
