// Builds the application into dist/, or into the directory that is named: `node build.mjs [DIRECTORY]`.
import { copyFile, mkdir } from "node:fs/promises";
import { build } from "esbuild";

const target = process.argv[2] ?? "dist";
await mkdir(target, { recursive: true });
await build({
  entryPoints: { console: "src/main.tsx" },
  outdir: target,
  bundle: true,
  minify: true,
  format: "esm",
  target: ["chrome109", "firefox115", "safari16"],
  jsx: "automatic",
  jsxImportSource: "preact",
  legalComments: "none",
  charset: "utf8",
});
for (const file of ["index.html", "icon.svg"]) await copyFile(`src/${file}`, `${target}/${file}`);
