/** Files of a laboratory, which the server reads: a workbook, or text of any encoding; chosen, or dropped onto the table. */

import { post } from "../api.js";
import { html, setText, show } from "../dom.js";
import { explained } from "../forms.js";
import { language, word } from "../words.js";

/** Return the field of a file whose table is put into `text`, a field that takes dropped files as well. */
export function fileField(text) {
  const problem = html.span({ class: "problem", role: "alert" });
  const sheets = html.span();
  const input = html.input({ type: "file", accept: ".xlsx,.csv,.txt,.tsv,text/csv,text/plain" });
  const take = (file) => file && read(file).then((tables) => offer(tables, file.name), (error) => setText(problem, explained(error)));
  input.addEventListener("change", () => take(input.files[0]));
  text.addEventListener("dragover", (event) => event.preventDefault());
  text.addEventListener("drop", (event) => {
    if (event.dataTransfer.files.length === 0) return;
    event.preventDefault();
    take(event.dataTransfer.files[0]);
  });
  return html.div(html.label(word("laboratory.file"), input), sheets, problem);

  /** Put the first table into the text, and offer the others of the workbook. */
  function offer(tables, name) {
    setText(problem, tables.length === 0 ? word("laboratory.empty-file", { name }) : "");
    if (tables.length > 0) text.value = tables[0].table;
    const options = tables.map(({ sheet }, number) => html.option({ value: number }, sheet));
    show(sheets, tables.length > 1 && html.label(word("laboratory.sheet"), html.select({ onchange: ({ target }) => (text.value = tables[target.value].table) }, options)));
  }
}

/** Return the tables of a file. */
async function read(file) {
  const bytes = new Uint8Array(await file.arrayBuffer());
  const letters = Array.from(bytes, (byte) => String.fromCharCode(byte)).join("");
  return (await post("/tables", { workbook: btoa(letters) })).items;
}

/** Return a link to rows as a CSV file in the language of the page: spreadsheets split it at ; where commas are decimal marks. */
export function csvLink(key, name, rows) {
  const mark = language() === "de" ? ";" : ",";
  const cell = (value) => (typeof value === "number" ? String(value).replace(".", language() === "de" ? "," : ".") : `"${String(value ?? "").replaceAll('"', '""')}"`);
  const content = `\ufeff${rows.map((row) => row.map(cell).join(mark)).join("\r\n")}\r\n`;
  return html.a({ class: "button", download: name, href: `data:text/csv;charset=utf-8,${encodeURIComponent(content)}` }, word(key));
}
