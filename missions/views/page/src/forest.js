// The tree as it was at the instant shown: its nodes, which of them are in sight, and where each stands.
import { computed, signal } from "@preact/signals";
import { hierarchy, tree as layered } from "d3-hierarchy";
import { at, chain, selected } from "./state.js";

export const ROW = 24; // height of a row of the outline [px]
export const BOX = { width: 176, height: 24, across: 216, down: 32 }; // a node of the drawing, and from one to the next [px]
const collapsed = signal(new Set()); // uids
export const query = signal("");
export const selectedNode = signal(null); // uid

/** The tree at the instant shown; the same while nothing changes in it. */
const tree = computed(() => at("tree", 0) ?? { nodes: [] });

function nodesOf({ nodes: all }) {
  const nodes = new Map();
  for (const [uid, parent, type, name, kind, elements] of all) {
    const above = nodes.get(parent);
    const node = { uid, type, name, kind, elements, above, depth: above ? above.depth + 1 : 0, children: [] };
    (above?.children ?? []).push(node);
    nodes.set(uid, node);
  }
  return [...nodes.values()];
}

/** Every node, parents before children. */
export const nodes = computed(() => nodesOf(tree.value));
const lineage = (node) => (node ? [node, ...lineage(node.above)] : []);

/** Which nodes a search leaves in sight: those that fit, and what is above them; null without a search. */
const found = computed(() => {
  const words = query.value.trim().toLowerCase();
  if (!words) return null;
  const fitting = nodes.value.filter((node) => `${node.name} ${node.type} ${node.kind}`.toLowerCase().includes(words));
  return new Set(fitting.flatMap(lineage));
});

export const isOpen = (node) => Boolean(query.value.trim()) || !collapsed.value.has(node.uid);

function inSight(node) {
  if (found.value && !found.value.has(node)) return [];
  return isOpen(node) ? [node, ...node.children.flatMap(inSight)] : [node];
}

/** The nodes in sight, in the order in which an outline lists them. */
export const rows = computed(() => nodes.value.filter((node) => !node.above).flatMap(inSight));

/** The nodes in sight as a drawing has them: {node, x, y, from: the place of its parent} and how large it is. */
export const drawing = computed(() => {
  const sight = new Set(rows.value);
  const forest = { children: rows.value.filter((node) => !node.above) };
  const root = hierarchy(forest, ({ children }) => children.filter((one) => sight.has(one)));
  layered().nodeSize([BOX.down, BOX.across])(root);
  const placed = root.descendants().filter((one) => one.parent);
  const top = Math.min(...placed.map((one) => one.x));
  const places = placed.map(({ data, x, y, parent }) => ({
    node: data, x: y - BOX.across, y: x - top, from: parent.parent ? { x: parent.y - BOX.across, y: parent.x - top } : null,
  }));
  const width = Math.max(0, ...places.map(({ x }) => x)) + BOX.width;
  const height = Math.max(0, ...places.map(({ y }) => y)) + BOX.height;
  return { places, width, height };
});

/** Choose a node, and the element that it is about. */
export function pick(node) {
  selectedNode.value = node.uid;
  if (node.elements.length) [selected.value] = node.elements;
}

export function toggle(node, open = !isOpen(node)) {
  const next = new Set(collapsed.value);
  if (open) next.delete(node.uid);
  else next.add(node.uid);
  collapsed.value = next;
}

export function toggleAll(open) {
  collapsed.value = new Set(open ? [] : nodes.value.filter((node) => node.above && node.children.length).map(({ uid }) => uid));
}

/** The first node that the chosen chain is about; what hides it is opened. */
export function firstOfChain() {
  const [node] = chain.value.flatMap((step) => nodes.value.filter((one) => one.elements.some((each) => step.elements.includes(each))));
  const hiding = new Set(lineage(node?.above).map(({ uid }) => uid));
  if ([...hiding].some((uid) => collapsed.value.has(uid))) {
    collapsed.value = new Set([...collapsed.value].filter((uid) => !hiding.has(uid)));
  }
  return node;
}

/** Status ("R", "S", "F", "" and small letters for what stands since an earlier tick) and feedback of a node at the instant. */
export const stateOf = (uid) => at("node", uid) ?? ["", ""];
