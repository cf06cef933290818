// SPDX-License-Identifier: Apache-2.0
// main.mjs - all tests of the Node client, as TAP; tests/test_node.sh prepares the package and calls it.
import { conformance } from './conformance.mjs';
import { hostile } from './hostile.mjs';
import { finish } from './kit.mjs';
import { live } from './live.mjs';
import { vectors } from './vectors.mjs';

const parts = { vectors, hostile, live, conformance };
for (const name of process.argv.length > 2 ? process.argv.slice(2) : Object.keys(parts))
  await parts[name]();
await finish();
