// What the first view loads is at most 100 KiB of script and style, compressed; and no dependency too many.

import assert from "node:assert/strict";
import fs from "node:fs";
import path from "node:path";
import test from "node:test";
import { gzipSync } from "node:zlib";
import { root } from "./farm.mjs";

const page = path.join(root, "services/dashboard");
const KIB = 1024;

test("script and style of the first view are at most 100 KiB compressed", () => {
  const index = fs.readFileSync(path.join(page, "dist/index.html"), "utf8");
  const files = [...index.matchAll(/(?:src|href)="\.\/(assets\/[^"]+)"/g)].map((match) => match[1]);
  assert.ok(
    files.some((file) => file.endsWith(".js")) && files.some((file) => file.endsWith(".css")),
    files.join(),
  );
  const sizes = files.map((file) => gzipSync(fs.readFileSync(path.join(page, "dist", file))).length);
  const sum = sizes.reduce((total, size) => total + size, 0);
  assert.ok(
    sum <= 100 * KIB,
    `${(sum / KIB).toFixed(1)} KiB: ${files.map((file, at) => `${file} ${sizes[at]}`).join(", ")}`,
  );
});

test("the page has no inline script or style, and at most five run-time dependencies", () => {
  const index = fs.readFileSync(path.join(page, "dist/index.html"), "utf8");
  assert.doesNotMatch(index, /<style|style=|<script(?![^>]*\bsrc=)/);
  const { dependencies } = JSON.parse(fs.readFileSync(path.join(page, "package.json"), "utf8"));
  assert.ok(Object.keys(dependencies).length <= 5, Object.keys(dependencies).join());
});
