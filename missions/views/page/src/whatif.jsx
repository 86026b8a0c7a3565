// What if a measurement were another: of the cases stored with a report for an instant, or asked of the base while it runs.
import { signal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { clock, extent, figure, withUnit } from "./format.js";
import { answer, ask, connection, may, order } from "./live.js";
import { Mark, Panel } from "./parts.jsx";
import { at, elements, revision, run, time } from "./state.js";

const STEPS = 200; // of a slider
const OWN = new Set(["action", "function", "component", "function design", "configuration"]); // whose statuses are told
const moved = signal({}); // values by attribute; in a report one at a time
const isLive = () => connection.value !== "none";
const nameOf = (element) => (element === null ? "nothing" : run.value.name(element));
const limitsOf = ({ thresholds }) => thresholds.map((one) => run.value.element(one).value);

/** The cases that were stored at the latest instant up to the one shown. */
function stored() {
  const until = run.value.last("whatif").map(([, one]) => one).filter(({ t, cases }) => t <= time.value && cases.length);
  return until.reduce((latest, one) => (latest && latest.t > one.t ? latest : one), null);
}

/** From where to where a measurement may be moved: over what it ever was, and its thresholds, and a fifth more. */
function rangeOf(key, element) {
  const values = [...run.value.of("value", key).values, ...limitsOf(element)].filter(Number.isFinite);
  const [low, high] = extent(values);
  const more = (high - low || 1) / 5;
  return [low >= 0 ? Math.max(0, low - more) : low - more, high + more];
}

function Measurement({ of, element, hint }) {
  const [low, high] = rangeOf(of, element);
  const value = moved.value[of] ?? at("value", of);
  const move = ({ target }) => (moved.value = { ...(isLive() && moved.value), [of]: target.valueAsNumber });
  return (
    <label class={of in moved.value ? "moved" : ""}>
      <span><span class="name">{element.name}</span> <b>{withUnit(figure(value, limitsOf(element)), element.unit)}</b></span>
      <input type="range" min={low} max={high} step={(high - low) / STEPS} value={value} onInput={move} />
      {hint && <small>{hint}</small>}
      {may.value.includes("inject") && of in moved.value && (
        <span class="tools">
          <button onClick={() => order("inject", { measure: { [element.name]: value } })}>Measure this from now on</button>
          <button onClick={() => order("inject", { release: [element.name] })}>Release</button>
        </span>
      )}
    </label>
  );
}

function interval({ low, high }) {
  if (low === null) return high === null ? "anything" : `below ${figure(high)}`;
  return high === null ? `${figure(low)} or more` : `from ${figure(low)} to below ${figure(high)}`;
}

/** What would follow: the actions that could be done, what would be chosen, and the statuses that would be others. */
function Outcome({ feasible, status, chosen }) {
  const chosenNow = (key) => at("choice", key)?.chosen ?? null;
  const switched = Object.entries(chosen).filter(([key, part]) => chosenNow(key) !== part);
  const others = Object.entries(status).filter(([key]) => OWN.has(run.value.element(key)?.kind));
  return (
    <dl class="details" aria-live="polite">
      <dt>feasible then</dt>
      <dd>{feasible.map((key) => <span class="part name" key={key}><Mark status="feasible" quiet /> {nameOf(key)}</span>)}</dd>
      {feasible.length === 0 && <dd>no action</dd>}
      {switched.length > 0 && <dt>chosen then</dt>}
      {switched.map(([key, part]) => <dd key={key} class="name">{nameOf(key)}: {nameOf(chosenNow(key))} → {nameOf(part)}</dd>)}
      {others.length > 0 && <dt>other statuses</dt>}
      {others.map(([key, to]) => <dd key={key}><span class="name">{nameOf(key)}</span> <Mark status={to} /></dd>)}
      {switched.length + others.length === 0 && <dd>Nothing would be other than it is.</dd>}
    </dl>
  );
}

function Stored() {
  const found = stored();
  if (!found) return <p class="muted">No cases are stored up to this instant.</p>;
  const [[key, value] = []] = Object.entries(moved.value);
  const fits = ({ attribute, low, high }) => String(attribute) === key && (low ?? -Infinity) <= value && value < (high ?? Infinity);
  const fitting = found.cases.find(fits);
  const offered = new Set(found.cases.map(({ attribute }) => attribute));
  const told = (key) => found.cases.filter(({ attribute }) => attribute === key).map(interval).join(" · ");
  return (
    <>
      {[...offered].map((one) => <Measurement key={one} of={one} element={run.value.element(one)} hint={told(one)} />)}
      {fitting && <p>If <span class="name">{nameOf(key)}</span> were {interval(fitting)}{fitting.now && ", as it is"}:</p>}
      {fitting && <Outcome {...fitting} />}
      <p class="muted">Of the cases stored for {clock(found.t)}: one measurement another, all else as it was then.</p>
    </>
  );
}

/** A component that is made to fail, or to recover. */
function Break({ what, components }) {
  const press = ({ target }) => {
    order("inject", { [what]: target.value });
    target.value = "";
  };
  return (
    <label>
      have {what === "fail" ? "fail" : "recovered"}{" "}
      <select onChange={press}>
        <option value="">no component</option>
        {components.map(([key, { name }]) => <option key={key}>{name}</option>)}
      </select>
    </label>
  );
}

function Asked() {
  const of = (kind) => elements.value.filter(([, one]) => one.kind === kind);
  const measured = Object.fromEntries(Object.entries(moved.value).map(([key, value]) => [nameOf(key), value]));
  const attributes = of("attribute").filter(([key]) => at("value", key) !== undefined);
  const isMoved = Object.keys(measured).length > 0;
  useEffect(() => void (isMoved && ask(measured)), [JSON.stringify(measured), Math.floor(revision.value / 10)]);
  return (
    <>
      {attributes.map(([key, one]) => <Measurement key={key} of={key} element={one} />)}
      {may.value.includes("inject") && ["fail", "recover"].map((what) => <Break key={what} what={what} components={of("component")} />)}
      {isMoved && answer.value?.error && <p class="bad">{answer.value.error}</p>}
      {isMoved && answer.value?.whatif && <Outcome {...answer.value.whatif} />}
      <p class="muted">Asked of the knowledge base as it is now; its facts stay as they are.</p>
    </>
  );
}

export function WhatIf() {
  const reset = <button onClick={() => (moved.value = {})} disabled={!Object.keys(moved.value).length}>Reset</button>;
  return (
    <Panel id="whatif" title="What if" aside={reset}>
      <div class="body" tabIndex={0} role="group" aria-label="what if">{isLive() ? <Asked /> : <Stored />}</div>
    </Panel>
  );
}
