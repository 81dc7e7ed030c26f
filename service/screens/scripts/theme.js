// Set theme and language before the first paint, and ask for the words beside the scripts; it blocks and stays this short.
(() => {
  const root = document.documentElement;
  const asked = new URLSearchParams(location.search).get("language");
  root.dataset.theme = localStorage.getItem("theme") ?? "auto";
  root.lang = asked ?? localStorage.getItem("language") ?? (navigator.language.startsWith("de") ? "de" : "en");
  const words = new URL(`../words/${root.lang === "de" ? "de" : "en"}.json`, document.currentScript.src);
  document.head.append(Object.assign(document.createElement("link"), { rel: "preload", as: "fetch", crossOrigin: "anonymous", href: words }));
})();
