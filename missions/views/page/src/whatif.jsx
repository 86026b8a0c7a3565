// What if a measurement were another, or a component failed: of the cases stored with a report, or asked of the base while it runs.
// It only supposes: nothing here changes a fact of the robot.
import { signal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { clock, extent, figure, withUnit } from "./format.js";
import { answer, ask, connection } from "./live.js";
import { Mark, Panel } from "./parts.jsx";
import { at, elements, revision, run, time, useAt } from "./state.js";

const STEPS = 200; // of a slider
const moved = signal({}); // values by attribute
const turned = signal({}); // "failed" or "recovered" by component; in a report, one thing at a time
const isLive = () => connection.value !== "none";
const nameOf = (element) => (element === null ? "nothing" : run.value.name(element));
const limitsOf = ({ constraints }) => constraints.map((one) => run.value.element(one).value);
const reset = () => (moved.value = turned.value = {});

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
  const move = ({ target }) => {
    if (!isLive()) reset();
    moved.value = { ...moved.value, [of]: target.valueAsNumber };
  };
  return (
    <label class={of in moved.value ? "moved" : ""}>
      <span><span class="name">{element.name}</span> <b>{withUnit(figure(value, limitsOf(element)), element.unit)}</b></span>
      <input type="range" min={low} max={high} step={(high - low) / STEPS} value={value} onInput={move} />
      {hint && <small>{hint}</small>}
    </label>
  );
}

/** A component that is supposed to fail, or to recover if it has failed. */
function Component({ of, verb }) {
  const isOn = of in turned.value;
  const turn = () => {
    const { [of]: before, ...others } = turned.value;
    if (!isLive()) reset();
    turned.value = before ? others : { ...(isLive() ? others : {}), [of]: verb };
  };
  return <button class="name" aria-pressed={isOn} onClick={turn}>{run.value.name(of)} {verb}</button>;
}

function interval({ low, high }) {
  if (low === null) return high === null ? "anything" : `below ${figure(high)}`;
  return high === null ? `${figure(low)} or more` : `from ${figure(low)} to below ${figure(high)}`;
}

/** What would follow: the actions that could be done, what would be chosen, and the statuses that would be others. */
function Outcome({ feasible, status, chosen }) {
  const chosenNow = (key) => at("choice", key)?.chosen ?? null;
  const switched = Object.entries(chosen).filter(([key, part]) => chosenNow(key) !== part);
  const others = Object.entries(status);
  return (
    <dl class="details" aria-live="polite">
      <dt>feasible then</dt>
      <dd>{feasible.map((key) => <span class="part name" key={key}><Mark status="feasible" quiet /> {nameOf(key)}</span>)}</dd>
      {feasible.length === 0 && <dd>no action</dd>}
      {switched.length > 0 && <dt>chosen then</dt>}
      {switched.map(([key, part]) => <dd key={key} class="name">{nameOf(key)}: {nameOf(chosenNow(key))} → {nameOf(part)}</dd>)}
      {others.length > 0 && <dt>other statuses</dt>}
      {others.map(([key, to]) => <dd key={key}><span class="name">{nameOf(key)}</span> <Mark status={to} /></dd>)}
      {switched.length + others.length === 0 && <dd>Nothing would change.</dd>}
    </dl>
  );
}

function Stored() {
  const latest = useAt("whatif", 0);
  const since = run.value.of("whatif").since(time.value);
  if (!latest?.length) return <p class="muted">No cases are stored up to this instant.</p>;
  const [[key, value] = []] = Object.entries(moved.value);
  const [component] = Object.keys(turned.value);
  const fits = ({ attribute, low, high }) => attribute === key && (low ?? -Infinity) <= value && value < (high ?? Infinity);
  const fitting = latest.find((one) => (component ? one.component === component : fits(one)));
  const of = (field) => [...new Set(latest.map((one) => one[field]).filter((one) => one !== undefined))];
  const told = (attribute) => latest.filter((one) => one.attribute === attribute).map(interval).join(" · ");
  return (
    <>
      {of("attribute").map((one) => <Measurement key={one} of={one} element={run.value.element(one)} hint={told(one)} />)}
      <div class="tools">
        {latest.filter(({ verb }) => verb).map((one) => <Component key={one.component} of={one.component} verb={one.verb} />)}
      </div>
      {fitting && (
        <p>
          If <span class="name">{nameOf(component ?? key)}</span>{" "}
          {component ? `had ${fitting.verb}` : `were ${interval(fitting)}`}{fitting.now && ", as it is"}:
        </p>
      )}
      {fitting && <Outcome {...fitting} />}
      <p class="muted">Cases stored at {clock(since)}: one thing is different, the rest is as it was then.</p>
    </>
  );
}

/** What a component is supposed to do: to recover if it has failed. */
const other = (key) => (at("status", key) === "failure" ? "recovered" : "failed");

function Asked() {
  const of = (kind) => elements.value.filter(([, one]) => one.kind === kind);
  const measured = Object.fromEntries(Object.entries(moved.value).map(([key, value]) => [nameOf(key), value]));
  const names = (verb) => Object.keys(turned.value).filter((key) => turned.value[key] === verb).map(nameOf);
  const attributes = of("attribute").filter(([key]) => at("value", key) !== undefined);
  const asked = { measured, failed: names("failed"), recovered: names("recovered") };
  const isAsked = Object.keys({ ...moved.value, ...turned.value }).length > 0;
  useEffect(() => void (isAsked && ask(asked)), [JSON.stringify(asked), Math.floor(revision.value / 10)]);
  return (
    <>
      {attributes.map(([key, one]) => <Measurement key={key} of={key} element={one} />)}
      <div class="tools">
        {of("component").map(([key]) => <Component key={key} of={key} verb={turned.value[key] ?? other(key)} />)}
      </div>
      {isAsked && answer.value?.error && <p class="bad">{answer.value.error}</p>}
      {isAsked && answer.value?.whatif && <Outcome {...answer.value.whatif} />}
      <p class="muted">Only supposed: the facts of the robot stay as they are.</p>
    </>
  );
}

export function WhatIf() {
  const isMoved = Object.keys({ ...moved.value, ...turned.value }).length > 0;
  return (
    <Panel id="whatif" title="What if" aside={<button onClick={reset} disabled={!isMoved}>Reset</button>}>
      <div class="body" tabIndex={0} role="group" aria-label="what if">{isLive() ? <Asked /> : <Stored />}</div>
    </Panel>
  );
}
