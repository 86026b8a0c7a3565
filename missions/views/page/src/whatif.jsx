// What if a measurement were another: of the cases stored with a report for an instant, or asked of the base while it runs.
import { signal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { at, elements, revision, run, time } from "./state.js";
import { answer, ask, may, order } from "./live.js";
import { figure, seconds, withUnit } from "./format.js";
import { Mark, Panel } from "./parts.jsx";

const STEPS = 200; // of a slider
const moved = signal({}); // values by attribute; in a report one at a time

const isLive = () => run.value.header.live;

/** What was stored at the latest instant up to the one shown. */
function stored() {
  const cases = run.value.last("whatif").map(([, one]) => one).filter(({ t, cases }) => t <= time.value && cases.length);
  return cases.sort((a, b) => a.t - b.t).at(-1);
}

/** From where to where a measurement may be moved: over what it ever was, and its thresholds, and a fifth more. */
function rangeOf(key, element) {
  const values = [...run.value.of("value", key).values, ...element.thresholds.map((one) => run.value.element(one).value)].filter(Number.isFinite);
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const more = (high - low || 1) / 5;
  return [low >= 0 ? Math.max(0, low - more) : low - more, high + more];
}

function Measurement({ of, element }) {
  const [low, high] = rangeOf(of, element);
  const now = at("value", of);
  const value = moved.value[of] ?? now;
  const limits = element.thresholds.map((one) => run.value.element(one).value);
  const move = (to) => (moved.value = isLive() ? { ...moved.value, [of]: to } : { [of]: to });
  return (
    <label class={of in moved.value ? "moved" : ""}>
      <span>
        <span class="name">{element.name}</span> <b>{withUnit(figure(value, limits), element.unit)}</b>
      </span>
      <input type="range" min={low} max={high} step={(high - low) / STEPS} value={value} onInput={({ target }) => move(target.valueAsNumber)} />
      {may.value.includes("inject") && of in moved.value && (
        <span class="tools">
          <button onClick={() => order("inject", { measure: { [element.name]: value } })}>Measure this from now on</button>
          <button onClick={() => order("inject", { release: [element.name] })}>Release</button>
        </span>
      )}
    </label>
  );
}

const interval = ({ low, high }) => (low === null && high === null ? "any value" : low === null ? `below ${figure(high)}` : high === null ? `from ${figure(low)}` : `from ${figure(low)} to below ${figure(high)}`);

/** What would follow: the actions that could be done, what would be chosen, and the statuses that would be others. */
function Outcome({ of: { feasible, status, chosen } }) {
  const actions = elements.value.filter(([, one]) => one.kind === "action");
  const others = Object.entries(status).filter(([key]) => ["action", "function", "component", "function design", "configuration"].includes(run.value.element(key)?.kind));
  const now = (key) => at("choice", key)?.chosen ?? null;
  const switched = Object.entries(chosen).filter(([key, part]) => now(key) !== part);
  const name = (part) => (part === null ? "nothing" : run.value.name(part));
  return (
    <dl class="details" aria-live="polite">
      <dt>feasible then</dt>
      <dd>{actions.filter(([key]) => feasible.map(String).includes(key)).map(([key, one]) => <span class="part" key={key}><Mark status="feasible" quiet /> <span class="name">{one.name}</span></span>)}{feasible.length === 0 && "no action"}</dd>
      {switched.length > 0 && <dt>chosen then</dt>}
      {switched.map(([key, part]) => <dd key={key}><span class="name">{run.value.name(key)}: {name(now(key))} → {name(part)}</span></dd>)}
      {others.length > 0 && <dt>other statuses</dt>}
      {others.map(([key, to]) => <dd key={key}><span class="name">{run.value.name(key)}</span> <Mark status={to} /></dd>)}
      {switched.length + others.length === 0 && <dd>Nothing would be other than it is.</dd>}
    </dl>
  );
}

function Stored() {
  const found = stored();
  if (!found) return <p class="muted">No cases are stored up to this instant.</p>;
  const offered = [...new Set(found.cases.map(({ attribute }) => String(attribute)))];
  const [key] = Object.keys(moved.value);
  const value = moved.value[key];
  const fits = found.cases.find((one) => String(one.attribute) === key && (one.low ?? -Infinity) <= value && value < (one.high ?? Infinity));
  return (
    <>
      {offered.map((one) => <Measurement key={one} of={one} element={run.value.element(one)} />)}
      {fits && <p>If {run.value.name(key)} were {interval(fits)}{fits.now ? ", as it is" : ""}:</p>}
      {fits && <Outcome of={fits} />}
      <p class="muted">Of the cases stored for {seconds(found.t)}: one measurement another, all else as it was then.</p>
    </>
  );
}

function Asked() {
  const attributes = elements.value.filter(([key, one]) => one.kind === "attribute" && run.value.of("value", key).times.length);
  const components = elements.value.filter(([, one]) => one.kind === "component");
  const measured = Object.fromEntries(Object.entries(moved.value).map(([key, value]) => [run.value.name(key), value]));
  useEffect(() => {
    if (Object.keys(measured).length) ask(measured, []);
  }, [JSON.stringify(measured), Math.floor(revision.value / 10)]);
  const break_ = (what) => (event) => event.target.value && (order("inject", { [what]: event.target.value }), (event.target.value = ""));
  return (
    <>
      {attributes.map(([key, one]) => <Measurement key={key} of={key} element={one} />)}
      {may.value.includes("inject") && ["fail", "recover"].map((what) => (
        <label key={what}>
          have a component {what}
          <select onChange={break_(what)}>
            <option value="">none</option>
            {components.map(([key, { name }]) => <option key={key}>{name}</option>)}
          </select>
        </label>
      ))}
      {answer.value?.error && <p class="bad">{answer.value.error}</p>}
      {answer.value?.whatif && Object.keys(measured).length > 0 && <Outcome of={answer.value.whatif} />}
      <p class="muted">Asked of the knowledge base as it is now; its facts stay as they are.</p>
    </>
  );
}

export function WhatIf() {
  const reset = <button onClick={() => (moved.value = {})} disabled={!Object.keys(moved.value).length}>Reset</button>;
  return (
    <Panel id="whatif" title="What if" aside={reset}>
      <div class="body" tabIndex={-1}>{isLive() ? <Asked /> : <Stored />}</div>
    </Panel>
  );
}
