// Set theme and language before the first paint; loaded in the head, so it blocks and stays this short.
(() => {
  const root = document.documentElement;
  const asked = new URLSearchParams(location.search).get("language");
  root.dataset.theme = localStorage.getItem("theme") ?? "auto";
  root.lang = asked ?? localStorage.getItem("language") ?? (navigator.language.startsWith("de") ? "de" : "en");
})();
