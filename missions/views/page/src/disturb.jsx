// Disturb a simulated mission: each act has a button of its own, and changes what the robot is told from now on.
import { signal } from "@preact/signals";
import { figure, withUnit } from "./format.js";
import { order as request, state } from "./live.js";
import { Panel, Standing } from "./parts.jsx";
import { at, elements } from "./state.js";

const typed = signal({}); // values by name of attribute

function Value({ of, element: { name, unit } }) {
  const held = state.value.held?.[name];
  const value = typed.value[name] ?? figure(at("value", of)).replace("−", "-");
  const measure = () => request("inject", { fault: `measure ${name}=${parseFloat(value)}` });
  return (
    <li class="act">
      <span class="name">{name}</span>
      <span class="tools">
        <input type="text" inputMode="decimal" aria-label={`value of ${name}`} value={value}
          onInput={({ target }) => (typed.value = { ...typed.value, [name]: target.value })} />
        <small>{unit}</small>
        <button disabled={!Number.isFinite(parseFloat(value))} onClick={measure}>Measure</button>
        <button disabled={held === undefined} onClick={() => request("inject", { fault: `release ${name}` })}>Release</button>
      </span>
      {held !== undefined && <small class="bad">injected: {withUnit(figure(held), unit)}</small>}
    </li>
  );
}

const Component = ({ of, element: { name } }) => (
  <li class="act">
    <span><Standing of={of} quiet /> <span class="name">{name}</span></span>
    <span class="tools">
      <button onClick={() => request("inject", { fault: `fail ${name}` })}>Fail</button>
      <button onClick={() => request("inject", { fault: `recover ${name}` })}>Recover</button>
    </span>
  </li>
);

export function Disturb() {
  const of = (kind) => elements.value.filter(([, one]) => one.kind === kind);
  return (
    <Panel id="disturb" title="Disturb">
      <div class="body" tabIndex={0} role="group" aria-label="disturb">
        <p class="muted">Each button changes what the running robot is told.</p>
        <h3>Measurements</h3>
        <ul>{of("attribute").map(([key, one]) => <Value key={key} of={key} element={one} />)}</ul>
        <h3>Components</h3>
        <ul>{of("component").map(([key, one]) => <Component key={key} of={key} element={one} />)}</ul>
      </div>
    </Panel>
  );
}
