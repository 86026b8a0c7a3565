// A run is its header and rows [t, track, key, value]: from t on, that key of that track has that value, until the next.
import { Track } from "./track.js";

const EMPTY = new Track();
const NUMBERED = new Set(["event", "action", "plan", "taskplan", "adaptation", "disturbance", "problem"]);

export class Run {
  #tracks = new Map();
  #count = 0;
  start = Infinity;
  end = -Infinity;
  moments = new Track(); // when anything was decided or became known
  amended = new Track(); // when there came to be other elements

  /** Of a mission that still runs, what is older than its middle is let go of after `most` rows. */
  constructor({ header, rows }, most = Infinity) {
    Object.assign(this, { header, most });
    this.add(rows);
  }

  add(rows) {
    for (const [t, track, key, value] of rows) {
      if (!this.#tracks.has(track)) this.#tracks.set(track, new Map());
      const keys = this.#tracks.get(track);
      if (!keys.has(String(key))) keys.set(String(key), new Track());
      keys.get(String(key)).set(t, value);
      if (track === "tick" || track === "event") this.moments.set(t, true);
      if (track === "element") this.amended.set(t, true);
      this.reach(t);
    }
    this.#count += rows.length;
    if (this.#count > this.most) this.#forget((this.start + this.end) / 2);
  }

  /** Let go of what was before t, but for what holds then. */
  #forget(t) {
    for (const [track, keys] of this.#tracks) {
      for (const [key, one] of keys) {
        one.forget(t);
        if (NUMBERED.has(track) && one.times.at(-1) < t && one.last?.end !== null) keys.delete(key);
      }
    }
    this.moments.forget(t);
    [this.start, this.#count] = [t, this.#count / 2];
  }

  /** The run has come to t, whether or not there was anything to tell. */
  reach(t) {
    this.start = Math.min(this.start, t);
    this.end = Math.max(this.end, t);
  }

  of(track, key = 0) {
    return this.#tracks.get(track)?.get(String(key)) ?? EMPTY;
  }

  keys(track) {
    return [...(this.#tracks.get(track)?.keys() ?? [])];
  }

  /** The last words on each key of a track, as [key, value], but for what is gone. */
  last(track) {
    return this.keys(track).map((key) => [key, this.of(track, key).last]).filter(([, value]) => value !== null);
  }

  /** What is known of an element, whenever. */
  element(key) {
    return this.of("element", key).values.findLast((value) => value !== null);
  }

  name(key) {
    return this.element(key)?.name ?? key;
  }
}
