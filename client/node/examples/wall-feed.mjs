#!/usr/bin/env node
// SPDX-License-Identifier: Apache-2.0
// wall-feed.mjs - opens an LED wall and feeds it a picture that moves: wall-feed.mjs WALL.yaml [SECONDS]
//
// draw() is what to put your own pixels into: linear light; brighter than 1 glows. The stream takes a frame when there is room for it.
import { readFile } from 'node:fs/promises';
import { Readable } from 'node:stream';
import { pipeline } from 'node:stream/promises';
import { setTimeout as sleep } from 'node:timers/promises';
import { connect } from '@airyd/client';

const [file, seconds = 1e9] = process.argv.slice(2);
const width = 192, height = 108;

function draw(t) {
  const out = new Float32Array(width * height * 3).fill(0.02);
  const cx = width * (0.5 + 0.4 * Math.sin(t)), cy = height / 2;
  for (let y = 0, at = 0; y < height; y++)
    for (let x = 0; x < width; x++, at += 3) {
      const spot = Math.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 40);
      out[at] += 8 * spot;
      out[at + 1] += 4 * spot;
      out[at + 2] += spot;
    }
  return out;
}

async function* frames(rate) {
  const begin = performance.now();
  for (let t = 0; t < Number(seconds) * 1000; t = performance.now() - begin) {
    yield draw(t / 1000);
    await sleep(1000 / rate - ((performance.now() - begin) % (1000 / rate)));
  }
}

const airy = await connect(), definition = await readFile(file, 'utf8');
const wall = await airy.wallOpen(definition);
console.log(`${wall.name}: ${wall.leds} LEDs, ${wall.rate} frames/s`);
// The first one takes longest: what it needs is made.
await airy.bloom(draw(0), {}, { wall: wall.name, show: true, raw: { width, height } });
// A frame whose daemon went is left out; when the wall went with it, it is opened again.
const onError = async (error) => {
  if (error.symbol === 'NO_WALL')
    await airy.wallOpen(definition).catch((e) => console.error(e.message));
  else if (!error.retryable)
    throw error;
};
await pipeline(Readable.from(frames(wall.rate)), airy.stream({}, { wall: wall.name, show: true, raw: { width, height }, onError }));
const { frames: came, shown, dropped } = (await airy.wallList(wall.name)).walls[0];
console.log(`${came} frames, ${shown} shown, ${dropped} dropped`);
airy.close();
