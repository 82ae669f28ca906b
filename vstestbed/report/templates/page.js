// Sorts a table by the column whose head is clicked, and shows the differences against the chosen controller.
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
  heads.forEach((head, column) => head.querySelector("button").addEventListener("click", () => {
    const down = head.getAttribute("aria-sort") === "ascending", key = row => row.cells[column].dataset.value;
    const number = text => text !== "" && isFinite(text);
    heads.forEach(other => other.setAttribute("aria-sort", other !== head ? "none" : down ? "descending" : "ascending"));
    const order = (a, b) => number(a) && number(b) ? a - b : a.localeCompare(b, undefined, { numeric: true });
    [...body.rows].sort((one, two) => {
      const a = key(one), b = key(two);
      return a === "" || b === "" ? (a === "") - (b === "") : (down ? -1 : 1) * order(a, b);
    }).forEach(row => body.append(row));
  }));
}
const reference = document.getElementById("reference");
if (reference) {
  const show = () => document.querySelectorAll(".against").forEach(part => { part.hidden = part.dataset.reference !== reference.value; });
  reference.addEventListener("change", show);
  show();
}
