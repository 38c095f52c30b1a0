/** The displayed time of a recorded run. */

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5];

/** Determines the displayed frame, which has a fractional part while the run is playing. */
export class Clock {
  /** @param {number} frames @param {number} fps */
  constructor(frames, fps) {
    this.frames = frames;
    this.fps = fps;
    this.at = 0;
    this.speed = 1;
    this.isPlaying = false;
    this.isLooping = true;
  }

  /** The nearest frame. */
  get frame() { return Math.round(this.at); }

  /** The time since the start in s. */
  get time() { return this.at / this.fps; }

  get end() { return (this.frames - 1) / this.fps; }

  /** @param {number} frame */
  seek(frame) { this.at = Math.min(Math.max(frame, 0), this.frames - 1); }

  /** Steps by whole frames, and pauses. @param {number} count */
  step(count) {
    this.isPlaying = false;
    this.seek(this.frame + count);
  }

  /** @param {number} places in `SPEEDS` */
  changeSpeed(places) {
    const at = SPEEDS.indexOf(this.speed) + places;
    this.speed = SPEEDS[Math.min(Math.max(at, 0), SPEEDS.length - 1)];
  }

  /** Plays or pauses. At the end, plays from the start. */
  toggle() {
    if (!this.isPlaying && this.at >= this.frames - 1) this.at = 0;
    this.isPlaying = !this.isPlaying && this.frames > 1;
  }

  /** @param {number} seconds of real time */
  advance(seconds) {
    if (!this.isPlaying) return;
    this.at += seconds * this.fps * this.speed;
    const last = this.frames - 1;
    if (this.at < last) return;
    this.at = this.isLooping ? this.at % Math.max(last, 1) : last;
    this.isPlaying = this.isLooping;
  }
}
