// A mission that still runs: rows come over a socket and are appended; the present first, then the past as it is asked for.
import { batch, signal } from "@preact/signals";
import { readLink } from "./link.js";
import { Run } from "./run.js";
import { isFollowing, revision, run, time } from "./state.js";

const [PAST, MOST] = [20_000, 200_000]; // rows the server gives in one answer, and rows to keep
const PATIENCE_MS = [500, 1000, 2000, 4000, 8000];
export const connection = signal("none"); // none (a report), connecting, connected, lost, refused
export const dropped = signal(0);
export const state = signal({}); // paused, speed, over, pages
export const may = signal([]);
export const complaint = signal("");
export const answer = signal(null); // of what was asked last

let socket;
let [failures, asked, wanted] = [0, 0, 0]; // wanted: number of the row up to which the past is asked for

const send = (message) => socket.readyState === WebSocket.OPEN && socket.send(JSON.stringify(message));
export const order = (what, more = {}) => send({ do: what, ...more });
export const ask = (supposed) => send({ ask: "whatif", id: (asked += 1), ...supposed });

export function connect(path) {
  const url = new URL(path, location.href);
  url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  socket = new WebSocket(url);
  if (connection.value === "none") connection.value = "connecting";
  socket.onmessage = ({ data }) => batch(() => hear(JSON.parse(data)));
  socket.onclose = ({ code, reason }) => {
    connection.value = code === 1008 ? "refused" : "lost";
    if (reason) complaint.value = reason;
    if (code !== 1008) setTimeout(connect, PATIENCE_MS[Math.min(failures++, PATIENCE_MS.length - 1)], path);
  };
}

function hear(message) {
  if (message.hello) greet(message);
  else if (message.past) learn(message);
  else if (message.rows) extend(message);
  else if (message.id === asked) answer.value = message;
  else if (message.error) complaint.value = message.error;
}

function greet({ hello, rows, now, first, next, may: allowed, state: is }) {
  const isSameRun = JSON.stringify(run.value?.header) === JSON.stringify(hello) && run.value.next <= next;
  const known = isSameRun ? run.value.next : first;
  if (isSameRun) run.value.add(rows);
  else run.value = new Run({ header: hello, rows }, MOST);
  if (!isSameRun) isFollowing.value = !readLink();
  run.value.next = next;
  may.value = allowed;
  failures = 0;
  connection.value = "connected";
  complaint.value = "";
  arrive(now, is);
  wanted = next;
  askForPast(known);
}

function extend({ rows, from, now, dropped: lost, state: is }) {
  run.value.add(rows);
  run.value.next = from + rows.length;
  dropped.value = lost;
  arrive(now, is);
}

function learn({ past, from }) {
  run.value.add(past);
  revision.value += 1;
  if (past.length) askForPast(from + past.length);
}

function askForPast(from) {
  if (from < wanted) send({ past: [from, Math.min(wanted, from + PAST)] });
}

function arrive(now, is) {
  run.value.reach(now);
  revision.value += 1;
  state.value = is;
  if (isFollowing.value) time.value = now;
}
