// A track is what one thing was over time: times and values, in order; what it is at an instant is found by bisection.
// So an instant costs the same wherever it is, backward as forward, in a report as in a mission that still runs.

/** How many of the ascending times are at or before t. */
export function countUntil(times, t) {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle + 1;
    else high = middle;
  }
  return low;
}

export class Track {
  times = [];
  values = [];

  /** Say what it is from t on; mostly the newest, but a live page asks for its past after it has the present. */
  set(t, value) {
    const place = countUntil(this.times, t);
    if (this.times[place - 1] === t) {
      this.values[place - 1] = value;
    } else if (place === this.times.length) {
      this.times.push(t);
      this.values.push(value);
    } else {
      this.times.splice(place, 0, t);
      this.values.splice(place, 0, value);
    }
  }

  /** What it is at t; undefined before the first change. */
  at(t) {
    return this.values[countUntil(this.times, t) - 1];
  }

  /** Since when it is as it is at t. */
  since(t) {
    return this.times[countUntil(this.times, t) - 1];
  }

  /** Let go of what was before t, but for what holds then. */
  forget(t) {
    const gone = Math.max(0, countUntil(this.times, t) - 1);
    for (const column of [this.times, this.values]) column.splice(0, gone);
  }

  get last() {
    return this.values[this.values.length - 1];
  }

  /** The spans [start, end, value] up to `end` in which a value holds. */
  spans(end) {
    return this.times.map((start, index) => [start, this.times[index + 1] ?? Math.max(end, start), this.values[index]]);
  }
}
