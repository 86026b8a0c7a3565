// A mission that still runs: rows come over a socket and are added; the present first, then the past, then what is new.
import { batch, signal } from "@preact/signals";
import { readLink } from "./link.js";
import { Run } from "./run.js";
import { isFollowing, revision, run, time } from "./state.js";

const MOST = 200_000; // rows to keep
export const connection = signal("none"); // none (a report), connecting, connected, lost, refused
export const dropped = signal(0);
export const state = signal({}); // paused, speed, over, pages
export const may = signal([]);
export const complaint = signal("");
export const answer = signal(null); // of what was asked last

let socket;
let [failures, asked] = [0, 0];

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
    if (code !== 1008) setTimeout(connect, Math.min(500 * 2 ** failures++, 8000), path);
  };
}

function hear(message) {
  if (message.rows) extend(message);
  else if (message.id === asked) answer.value = message;
  else if (message.error) complaint.value = message.error;
}

/** Add rows; the first of a connection come with what the run is, and what may be done with it. */
function extend({ hello, may: allowed, rows, now, dropped: lost, state: is }) {
  const isFirst = !run.value;
  if (hello) {
    run.value = new Run({ header: hello, rows: [] }, MOST);
    [may.value, connection.value, complaint.value, failures] = [allowed, "connected", "", 0];
  }
  run.value.add(rows);
  run.value.reach(now);
  revision.value += 1;
  state.value = is;
  if (lost) dropped.value = lost;
  if (isFirst) isFollowing.value = !readLink();
  if (isFollowing.value) time.value = now;
}
