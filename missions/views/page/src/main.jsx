import "uplot/dist/uPlot.min.css";
import "./theme.css";
import "./layout.css";
import "./views.css";
import "./print.css";
import { render } from "preact";
import { App } from "./app.jsx";
import { listenToKeys } from "./keys.js";
import { keepLink, readLink } from "./link.js";
import { connect } from "./live.js";
import { Run } from "./run.js";
import { end, runs, time } from "./state.js";

const given = JSON.parse(document.getElementById("rosa-data").textContent);
runs.value = given.runs.map((one) => new Run(one));
if (runs.value.length) {
  time.value = end.value;
  readLink();
}
keepLink();
listenToKeys();
render(<App differences={given.differences ?? []} note={given.note ?? ""} />, document.getElementById("app"));
if (given.live) connect(given.live.socket);
