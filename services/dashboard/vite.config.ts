import { defineConfig, loadEnv } from "vite";

// Where the API is while the page is developed with `npm run dev`.
const service = loadEnv("", ".", "FORELIGHT_")["FORELIGHT_SERVER"] ?? "http://127.0.0.1:7878";

export default defineConfig({
  base: "./",
  esbuild: { jsx: "automatic", jsxImportSource: "preact" },
  build: {
    target: "es2022",
    // The policy of the page allows no inline script, so nothing is inlined.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    reportCompressedSize: false,
  },
  server: { proxy: { "/v1": { target: service, changeOrigin: false } } },
});
