// Bundles src/ into dist/page.js and dist/page.css: the same sources and lock give the same bytes.
// `npm ci && npm run build` here, or `make page` at the root.
import { createHash } from "node:crypto";
import { mkdirSync, readdirSync, readFileSync, writeFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const root = fileURLToPath(new URL(".", import.meta.url));
const read = (path) => readFileSync(root + path, "utf8");
const { dependencies } = JSON.parse(read("package.json"));

const sources = ["build.mjs", "package-lock.json", "package.json", ...readdirSync(`${root}src`).sort().map((name) => `src/${name}`)];
const hash = createHash("sha256");
for (const path of sources) hash.update(`${path}\0${read(path)}\0`);

// What is bundled asks for its licence to go with every copy; a report is one.
const bundled = { ...dependencies, "@preact/signals-core": "" };
const licences = Object.keys(bundled).sort().map((name) => `${name}: ${read(`node_modules/${name}/LICENSE`).trim()}`);

const { outputFiles } = await build({
  absWorkingDir: root,
  entryPoints: { page: "src/main.jsx" },
  outdir: "dist",
  bundle: true,
  minify: true,
  write: false,
  format: "iife",
  target: ["es2022"],
  jsx: "automatic",
  jsxImportSource: "preact",
  legalComments: "none",
  logLevel: "warning",
});
mkdirSync(`${root}dist`, { recursive: true });
for (const { path, text } of outputFiles) {
  const banner = [`sources ${hash.copy().digest("hex")}`, ...(path.endsWith(".js") ? licences : [])].join("\n\n");
  writeFileSync(path, `/*! ${banner.replaceAll("*/", "* /")} */\n${text.replaceAll("</script", "<\\/script")}`);
}
