// Plays what is past, as fast as asked for, until the end.
import { effect, signal } from "@preact/signals";
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
    if (!isFollowing.peek()) seek(time.peek() + ((now - before) / 1000) * speed.peek());
    before = now;
    if (time.peek() >= end.peek()) isPlaying.value = false;
    else frame = requestAnimationFrame(turn);
  });
  return () => cancelAnimationFrame(frame);
});
