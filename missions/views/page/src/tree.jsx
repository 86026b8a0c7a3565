// The tree at the instant shown, as an outline of which only the rows in sight are made, or drawn; and the node that is chosen.
import { useComputed, useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { firstOfChain, isOpen, nodes, pick, query, ROW, rows, selectedNode, stateOf, toggle, toggleAll } from "./forest.js";
import { Graph } from "./graph.jsx";
import { at, chosen, isPrinting } from "./state.js";
import { Badges, Mark, Name, Panel, Standing } from "./parts.jsx";

const KINDS = { sequence: "→", selector: "?", parallel: "⇉", decorator: "◇", action: "■", condition: "○", plan: "≡", other: "•" };

function Row({ node, index, of }) {
  const [status, feedback] = useComputed(() => stateOf(node.uid)).value;
  const element = node.elements[0];
  const isChosen = selectedNode.value === node.uid;
  return (
    <div
      role="treeitem"
      id={`node-${node.uid}`}
      class={`row ${/[rsf]/.test(status) ? "stands" : ""}`}
      style={{ top: `${index * ROW}px`, paddingLeft: `${6 + node.depth * 14}px` }}
      aria-level={node.depth + 1}
      aria-posinset={index + 1}
      aria-setsize={of}
      aria-selected={isChosen}
      aria-expanded={node.children.length ? isOpen(node) : undefined}
      onClick={() => pick(node)}
    >
      <span class="turn" aria-hidden="true" onClick={(event) => (event.stopPropagation(), toggle(node))}>
        {node.children.length ? (isOpen(node) ? "▾" : "▸") : ""}
      </span>
      <Mark status={status} quiet />
      <span class="kind" title={`${node.kind}: ${node.type}`} aria-label={node.kind} role="img">{KINDS[node.kind] ?? KINDS.other}</span>
      <span class="label">{node.name}</span>
      <Badges list="nodes" one={node.uid} />
      {element !== undefined && <Standing of={element} quiet />}
      <span class="feedback">{feedback}</span>
    </div>
  );
}

function Outline() {
  const list = useRef(null);
  const sight = useSignal([0, 600]);
  const look = () => (sight.value = [list.current.scrollTop, list.current.clientHeight]);
  const bring = (index) => {
    const place = index * ROW;
    const { scrollTop, clientHeight } = list.current;
    if (place < scrollTop || place + ROW > scrollTop + clientHeight) list.current.scrollTop = place - clientHeight / 3;
  };
  useEffect(() => {
    const watch = new ResizeObserver(look);
    watch.observe(list.current);
    return () => watch.disconnect();
  }, []);
  useEffect(() => {
    const node = chosen.value !== null && firstOfChain();
    if (node) bring(rows.value.indexOf(node));
  }, [chosen.value]);
  const all = rows.value;
  const first = isPrinting.value ? 0 : Math.max(0, Math.floor(sight.value[0] / ROW) - 5);
  const last = isPrinting.value ? all.length : Math.ceil((sight.value[0] + sight.value[1]) / ROW) + 5;
  const onKeyDown = (event) => {
    const here = all.findIndex(({ uid }) => uid === selectedNode.value);
    const node = all[here];
    const moves = {
      ArrowDown: () => all[here + 1],
      ArrowUp: () => all[here - 1],
      Home: () => all[0],
      End: () => all[all.length - 1],
      ArrowRight: () => node && (isOpen(node) ? node.children[0] : toggle(node, true)),
      ArrowLeft: () => node && (isOpen(node) && node.children.length ? toggle(node, false) : node.above),
    };
    if (!moves[event.key]) return;
    event.preventDefault();
    const next = moves[event.key]();
    if (next) {
      pick(next);
      bring(rows.value.indexOf(next));
    }
  };
  const active = all.some(({ uid }) => uid === selectedNode.value) ? `node-${selectedNode.value}` : undefined;
  return (
    <div class="outline" role="tree" aria-label="nodes of the tree" tabIndex={0} aria-activedescendant={active} ref={list} onScroll={look} onKeyDown={onKeyDown}>
      <div role="none" style={{ height: `${all.length * ROW}px` }}>
        {all.slice(first, last).map((node, index) => <Row key={node.uid} node={node} index={first + index} of={all.length} />)}
      </div>
    </div>
  );
}

/** What there is to say of the node that is chosen. */
function Chosen() {
  const node = nodes.value.find(({ uid }) => uid === selectedNode.value);
  if (!node) return null;
  const [status, feedback] = stateOf(node.uid);
  return (
    <div class="chosen">
      <p>
        <Mark status={status} /> <b>{node.name}</b> <small>{node.type}{/[rsf]/.test(status) ? ", since an earlier tick" : ""}</small> {feedback}
      </p>
      {node.elements.map((element) => (
        <p key={element}>
          <Mark status={at("status", element)} /> <Name of={element} /> {at("why", element)}
        </p>
      ))}
    </div>
  );
}

export function Tree() {
  const isDrawn = useSignal(false);
  const aside = (
    <div class="tools">
      <input type="search" aria-label="search the tree" placeholder="search" value={query.value} onInput={({ target }) => (query.value = target.value)} />
      <button onClick={() => toggleAll(true)} aria-label="open every node" title="open every node">▾</button>
      <button onClick={() => toggleAll(false)} aria-label="close every node" title="close every node">▸</button>
      <button aria-pressed={isDrawn.value} onClick={() => (isDrawn.value = !isDrawn.value)}>Drawn</button>
    </div>
  );
  return (
    <Panel id="tree" title={`Tree · ${nodes.value.length} nodes`} aside={aside}>
      {nodes.value.length === 0 ? <p class="body muted">No tree at this instant.</p> : isDrawn.value ? <Graph /> : <Outline />}
      <Chosen />
    </Panel>
  );
}
