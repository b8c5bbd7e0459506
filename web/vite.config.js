import { defineConfig } from "vite";

// The build is committed and shipped inside the wheel: names without hashes keep its history readable, and the server
// tells browsers to ask again (ETag).
export default defineConfig({
  base: "./",
  build: {
    outDir: "../src/conetl/web/static",
    emptyOutDir: true,
    target: "es2022",
    modulePreload: { polyfill: false },
    assetsInlineLimit: 0,
    chunkSizeWarningLimit: 800,
    rollupOptions: {
      output: {
        entryFileNames: "assets/[name].js",
        chunkFileNames: "assets/[name].js",
        assetFileNames: "assets/[name][extname]",
      },
    },
  },
});
