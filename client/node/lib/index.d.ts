// SPDX-License-Identifier: Apache-2.0
// index.d.ts - the manual of the Node client. Messages, parameters and error symbols come from gen/, made from the contract.
//
// Payloads go inline: Node's sockets carry no descriptors. A buffer that is given to bloom, plan or asset must not change until the
// promise has settled. 64-bit numbers are bigint.
import type { Duplex, DuplexOptions, Writable } from 'node:stream';
import type { AssetKept, Controller, Device, Energy, ExrOptions, Limits, Progress, Region, StageTimes, StatusReply, Target, WallBoard, WallState,
  WallSupply } from '../gen/messages.js';
import type { Params } from '../gen/params.js';
import type { FaultSymbol } from '../gen/symbols.js';

export type { AssetKept, Controller, Device, Energy, FaultSymbol, Limits, Params, Progress, Region, StageTimes, StatusReply, Target, WallBoard,
  WallState, WallSupply };

export interface ReconnectOptions {
  /** for so long a daemon that has gone is waited for; default 15 000 */
  forMs?: number;
  /** tries to open a connection, with growing pauses; default 100 */
  attempts?: number;
  /** the first pause; default 20 */
  delayMs?: number;
  /** the longest pause; default 1000 */
  delayMsMax?: number;
  /** times that one request is asked again after a lost connection, so that a frame that ends the daemon does not do so for ever; default 3 */
  resubmits?: number;
}

export interface ConnectOptions {
  /** the socket; default: $AIRY_SOCKET, $XDG_RUNTIME_DIR/airyd.sock, /run/airyd/airyd.sock, the first that answers */
  path?: string;
  /** for all of connecting, each time, which may start a daemon; default 30 000 */
  timeoutMs?: number;
  /** open a lost connection again, and ask again what was in flight and gives the same however often it is asked: all but frames that are
      shown, and the opening, closing and testing of walls; false: all of it is rejected with DISCONNECTED; default true */
  reconnect?: boolean | ReconnectOptions;
  /** times that a request is sent again after BUSY, when the daemon says; default 20 */
  busyRetries?: number;
  /** what the daemon's log calls this program */
  client?: string;
}

export interface RawChannel {
  name: string;
  /** bytes, as in section 5 of PROTOCOL.md */
  offset: number | bigint | string;
  rowStride: number | bigint | string;
  pixelStride: number;
}

export interface RawLayout {
  width: number;
  height: number;
  /** of bytes; a typed array says it itself (Float32Array; Uint16Array and Float16Array: half) */
  type?: 'half' | 'float' | 'PIXEL_HALF' | 'PIXEL_FLOAT';
  /** interleaved samples without padding, by name ('RGBA', ['R', 'G', 'B', 'id.A']), or where each one is; default 'RGB' */
  channels?: string | readonly string[] | readonly RawChannel[];
}

export interface PlanOptions {
  signal?: AbortSignal;
  /** which part, layer, view; pixel type and compression of the output */
  exr?: Partial<ExrOptions>;
  /** the input is pixels, not a file */
  raw?: RawLayout;
  /** the name of an open wall: the frame becomes its picture, and the result is the wall's linear drive */
  wall?: string;
  /** with a wall, raw pixels that are a part of a frame: the whole frame's size, and where the part's first pixel is */
  partOf?: { frameWidth: number; frameHeight: number; x: number; y: number };
}

export interface BloomOptions extends PlanOptions {
  /** the frame goes on the wall, and nothing comes back; it is not asked again of another daemon, for its time will have gone */
  show?: boolean;
  /** with show: at the first tick from then on, of CLOCK_MONOTONIC (process.hrtime.bigint()); default 0: the next one */
  presentNs?: bigint | number;
  /** -10 to 10, orders what this user has waiting; default 0 */
  priority?: number;
  /** what has not had its turn by then is rejected with DEADLINE; default 0: none */
  deadlineMs?: number;
  onProgress?: (progress: Progress) => void;
  /** takes the output's bytes as they come, in place of result.output; a full one holds the connection. It is not ended. After an error,
      what it has got is not to be used. */
  into?: Writable;
}

/** A buffer of an EXR file, or, with `raw`, of pixels. */
export type Input = ArrayBufferView | ArrayBuffer | SharedArrayBuffer;
/** The kind of array that comes back: that of raw samples is the input's. */
export type OutputOf<I extends Input> = I extends Float32Array ? Float32Array : I extends Uint16Array ? Uint16Array : Buffer;

export interface Result<O> {
  /** null with `into`, and of a plan */
  output: O;
  /** bytes of output */
  size: number;
  /** each bloomed layer: window, plan, bound, energy, NaN counts */
  targets: Target[];
  /** sums over all targets */
  energy: Energy;
  /** the largest of the targets' error bounds, which hold at every pixel */
  bound: number;
  ms: StageTimes | null;
  /** what was dropped or changed, in words */
  notes: string[];
  device: string;
  chunks: number;
  /** of them copied compressed, as they were */
  chunksCopied: number;
  exposure: number;
  /** with a wall: of the frame, what its panels' light comes from */
  need: Region | null;
  /** of an EXR file: the attribute "airy" that the output has */
  stamp: string;
}

/** A wall's linear drive: height rows of width pixels of R, G, B. */
export interface Drive extends Result<Float32Array> {
  width: number;
  height: number;
}

export interface Walls {
  walls: WallState[];
  /** plugged in, of a kind that can be driven */
  controllers: Controller[];
  /** why there is no USB at all, or empty */
  usb: string;
}

/** What was sent to a wall's boards last: rows of R, G, B bytes of sRGB; pixels without an LED are 0. */
export interface Preview {
  wall: WallState;
  width: number;
  height: number;
  data: Buffer;
}

export interface StreamOptions<R extends boolean = false> extends Omit<BloomOptions, 'into'> {
  /** frames between the writer and the reader; default 4 */
  highWaterMark?: number;
  /** give whole results instead of their outputs; default false */
  results?: R;
  /** what stands for a frame that failed (undefined: nothing does); without it the first failure ends the stream */
  onError?: (error: AiryError & { index: number }, index: number, frame: Input) => unknown;
}

/** Frames in, bloomed frames out, in order; never more than highWaterMark in between. */
export class BloomStream extends Duplex {
  private constructor(options?: DuplexOptions);
}

export class Airy {
  private constructor();
  readonly server: string;
  readonly device: Device | null;
  readonly features: string[];
  readonly limits: Limits;
  readonly looks: string[];
  /** requests that have not ended, those cancelled included */
  readonly pending: number;

  bloom<I extends Input>(input: I, params: Params | undefined, options: BloomOptions & { into: Writable }): Promise<Result<null>>;
  bloom<I extends Input>(input: I, params: Params | undefined, options: BloomOptions & { wall: string; show: true }): Promise<Result<null>>;
  bloom<I extends Input>(input: I, params: Params | undefined, options: BloomOptions & { wall: string; show?: false }): Promise<Drive>;
  bloom<I extends Input>(input: I, params?: Params, options?: BloomOptions): Promise<Result<OutputOf<I>>>;
  /** What would run, its bound and its time; nothing is bloomed. */
  plan(input: Input, params?: Params, options?: PlanOptions): Promise<Result<null>>;
  /** Sends an EXR file to be kept, for the parameters dirt=DIGEST and psf=image:DIGEST. */
  asset(input: Input, options?: { signal?: AbortSignal }): Promise<AssetKept>;
  /** Answered at any load. */
  status(options?: { signal?: AbortSignal }): Promise<StatusReply>;
  /** With wall and show it is a Writable: nothing comes out. */
  stream<R extends boolean = false>(params?: Params, options?: StreamOptions<R>): BloomStream;
  /** All walls that are open, or one. */
  wallList(name?: string, options?: { signal?: AbortSignal }): Promise<Walls>;
  /** The text of airy-wall(5); calibration: asset()'s digest, when it names an image. Without keep the wall goes when this connection does,
      also when it is lost. */
  wallOpen(definition: string, options?: { calibration?: string; keep?: boolean; signal?: AbortSignal }): Promise<WallState>;
  /** Black, then away; whoever opened it. */
  wallClose(name: string, options?: { signal?: AbortSignal }): Promise<void>;
  /** order panels red green blue white ramp checker led black, instead of frames; "" ends it. level: linear, 0 to 1, 0: 0.25. */
  wallPattern(name: string, pattern?: string,
    options?: { board?: string; led?: number; level?: number; signal?: AbortSignal }): Promise<WallState>;
  wallPreview(name: string, options?: { signal?: AbortSignal }): Promise<Preview>;
  /** What is in flight is rejected with DISCONNECTED. */
  close(): void;
}

export function connect(options?: ConnectOptions): Promise<Airy>;

/** ARGUMENT: the call is wrong. CONNECT: no daemon answers. DISCONNECTED: the connection is gone. CANCELLED: an AbortSignal. */
export type LocalSymbol = 'ARGUMENT' | 'CONNECT' | 'DISCONNECTED' | 'CANCELLED';

export class AiryError extends Error {
  /** of section 8 of PROTOCOL.md; 0 of a LocalSymbol */
  readonly code: number;
  /** switch on this; a newer daemon may have more */
  readonly symbol: FaultSymbol | LocalSymbol | (string & {});
  /** one sentence for people */
  readonly text: string;
  /** what it is about: "params.threshold"; may be empty */
  readonly field: string;
  readonly retryable: boolean;
  readonly retryAfterMs: number;
  readonly queuePosition: number;
  /** client: said by this side, also of what the daemon sent against the protocol */
  readonly origin: 'daemon' | 'client';
}

/** name "AbortError", symbol "CANCELLED"; `cause` is the signal's reason. */
export class AiryAbortError extends AiryError {}
