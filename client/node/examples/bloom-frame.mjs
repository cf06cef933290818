#!/usr/bin/env node
// SPDX-License-Identifier: Apache-2.0
// bloom-frame.mjs - blooms one EXR: bloom-frame.mjs IN.exr OUT.exr [NAME=VALUE...], such as threshold=1.5 look=jimenez
import { readFile, rename, writeFile } from 'node:fs/promises';
import { connect } from '@airyd/client';

const [input, output, ...settings] = process.argv.slice(2);
if (!output) {
  console.error('Usage: bloom-frame.mjs IN.exr OUT.exr [NAME=VALUE]...');
  process.exit(2);
}
const params = Object.fromEntries(settings.map((s) => s.split(/=(.*)/s).slice(0, 2)));

let airy;
try {
  airy = await connect({ reconnect: true });
  const result = await airy.bloom(await readFile(input), params);
  // Whole or absent, also when this program is stopped meanwhile.
  await writeFile(`${output}.part`, result.output);
  await rename(`${output}.part`, output);
  for (const target of result.targets)
    console.log(`${target.name}: ${target.width}x${target.height}, error <= ${target.errorBound}, ${target.plan}`);
  console.log(`${output}: ${result.ms.total.toFixed(1)} ms on ${result.device}`);
} catch (error) {
  console.error(`bloom-frame: ${error.message}`);
  process.exitCode = error.retryable ? 75 : 1; // EX_TEMPFAIL: a farm may try again
} finally {
  airy?.close();
}
