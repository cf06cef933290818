// SPDX-License-Identifier: Apache-2.0
// index.d.ts - the manual of the Node client. Messages, parameters and error symbols come from gen/, made from the contract.
//
// Payloads go inline: Node's sockets carry no descriptors. A buffer that is given to bloom, plan or asset must not change until the
// promise has settled. 64-bit numbers are bigint.
import type { Duplex, DuplexOptions, Writable } from 'node:stream';
import type { AssetKept, Device, Energy, ExrOptions, Limits, Progress, StageTimes, StatusReply, Target } from '../gen/messages.js';
import type { Params } from '../gen/params.js';
import type { FaultSymbol } from '../gen/symbols.js';

export type { AssetKept, Device, Energy, FaultSymbol, Limits, Params, Progress, StageTimes, StatusReply, Target };

export interface ReconnectOptions {
  /** tries to open a connection, with growing pauses; default 10 */
  attempts?: number;
  /** the first pause; default 50 */
  delayMs?: number;
  /** the longest pause; default 2000 */
  delayMsMax?: number;
  /** times that one request is asked again after a lost connection, so that a frame that ends the daemon does not do so for ever; default 3 */
  resubmits?: number;
}

export interface ConnectOptions {
  /** the socket; default: $AIRY_SOCKET, $XDG_RUNTIME_DIR/airyd.sock, /run/airyd/airyd.sock, the first that answers */
  path?: string;
  /** for all of connecting, each time; default 5000 */
  timeoutMs?: number;
  /** open a lost connection again, and ask again what was in flight; default false */
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
}

export interface BloomOptions extends PlanOptions {
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
  bloom<I extends Input>(input: I, params?: Params, options?: BloomOptions): Promise<Result<OutputOf<I>>>;
  /** What would run, its bound and its time; nothing is bloomed. */
  plan(input: Input, params?: Params, options?: PlanOptions): Promise<Result<null>>;
  /** Sends an EXR file to be kept, for the parameters dirt=DIGEST and psf=image:DIGEST. */
  asset(input: Input, options?: { signal?: AbortSignal }): Promise<AssetKept>;
  /** Answered at any load. */
  status(options?: { signal?: AbortSignal }): Promise<StatusReply>;
  stream<R extends boolean = false>(params?: Params, options?: StreamOptions<R>): BloomStream;
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
