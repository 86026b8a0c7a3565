// Plays what is past, as fast as asked for, until the end.
import { effect, signal } from "@preact/signals";
import { stopBetween } from "./conditions.js";
import { end, isFollowing, seek, start, time } from "./state.js";

export const SPEEDS = [0.5, 1, 2, 5, 10, 30];
export const isPlaying = signal(false);
export const speed = signal(5);

export function togglePlay() {
  if (!isPlaying.value && time.value >= end.value) seek(start.value);
  isPlaying.value = !isPlaying.value;
}

effect(() => {
  if (!isPlaying.value) return;
  let before = performance.now();
  let frame = requestAnimationFrame(function turn(now) {
    const [from, until] = [time.peek(), time.peek() + ((now - before) / 1000) * speed.peek()];
    const stop = stopBetween(from, until);
    if (!isFollowing.peek()) seek(stop ?? until);
    before = now;
    if (stop !== undefined || time.peek() >= end.peek()) isPlaying.value = false;
    else frame = requestAnimationFrame(turn);
  });
  return () => cancelAnimationFrame(frame);
});
