// Tables of any length: sorted by a column, searched, a page at a time; rows can be picked.

class DataTable {
  // columns: [{name, text: left-aligned words}]; rows: arrays of cells; pick(index of row) if rows can be picked.
  constructor(place, { columns, rows, pick = null, size = 25, label }) {
    Object.assign(this, { columns, rows, pick, size, first: 0, order: rows.map((_, k) => k), by: -1, up: true, kept: () => true, words: "" });
    this.body = make("tbody");
    this.count = make("span", { className: "note", ariaLive: "polite" });
    this.back = make("button", { type: "button", click: () => this.turn(-1) }, "‹ before");
    this.next = make("button", { type: "button", click: () => this.turn(1) }, "next ›");
    this.search = make("input", { type: "search", placeholder: "search", ariaLabel: `search ${label}`,
      input: () => { this.words = this.search.value.toLowerCase(); this.arrange(); } });
    this.heads = columns.map((column, k) => make("th", { className: column.text ? "text" : "", scope: "col" },
      make("button", { type: "button", click: () => this.sort(k) }, column.name)));
    const table = make("table", { ariaLabel: label }, make("thead", {}, make("tr", {}, ...this.heads)), this.body);
    this.bar = make("div", { className: "bar" }, this.search, this.back, this.next, this.count);
    place.append(this.bar, make("div", { className: "scroll" }, table));
    this.arrange();
  }

  sort(k) {
    this.up = this.by === k ? !this.up : true;
    this.by = k;
    this.heads.forEach((head, i) => head.setAttribute("aria-sort", i === k ? (this.up ? "ascending" : "descending") : "none"));
    this.arrange();
  }

  keep(kept) { this.kept = kept; this.arrange(); }

  arrange() {
    const found = (row) => !this.words || row.some((cell) => String(cell ?? "").toLowerCase().includes(this.words));
    this.order = this.rows.map((_, k) => k).filter((k) => this.kept(k) && found(this.rows[k]));
    if (this.by >= 0) {
      const by = this.by, sign = this.up ? 1 : -1;
      this.order.sort((a, b) => sign * compare(this.rows[a][by], this.rows[b][by]) || a - b);
    }
    this.first = 0;
    this.fill();
  }

  turn(pages) { this.first += pages * this.size; this.fill(); }

  // Turn to the page with a row, and mark it.
  mark(index) {
    this.marked = index;
    const k = this.order.indexOf(index);
    if (k >= 0) this.first = k - (k % this.size);
    this.fill();
  }

  fill() {
    const shown = this.order.slice(this.first, this.first + this.size), last = this.first + shown.length;
    this.body.replaceChildren(...shown.map((k) => this.row(k)));
    this.count.textContent = this.order.length ? `${this.first + 1} to ${last} of ${this.order.length}` : "none";
    this.back.disabled = this.first === 0;
    this.next.disabled = last >= this.order.length;
    const one = this.rows.length <= this.size;
    this.back.hidden = this.next.hidden = this.search.hidden = one;
  }

  row(k) {
    const cells = this.columns.map((column, i) => make("td", { className: column.text ? "text" : "" }, cellText(this.rows[k][i])));
    const row = make("tr", {}, ...cells);
    if (!this.pick) return row;
    row.className = "pick";
    row.tabIndex = 0;
    row.setAttribute("aria-selected", k === this.marked);
    row.addEventListener("click", () => this.picked(k));
    row.addEventListener("keydown", (event) => {
      const other = { ArrowDown: row.nextElementSibling, ArrowUp: row.previousElementSibling }[event.key];
      if (event.key === "Enter" || event.key === " ") { event.preventDefault(); this.picked(k); }
      else if (other) { event.preventDefault(); other.focus(); }
    });
    return row;
  }

  picked(k) {
    this.marked = k;
    for (const row of this.body.rows) row.setAttribute("aria-selected", "false");
    this.body.rows[this.order.indexOf(k) - this.first]?.setAttribute("aria-selected", "true");
    this.pick(k);
  }
}

function compare(a, b) {
  if (a === b) return 0;
  if (a === null || a === undefined || a === "") return 1;
  if (b === null || b === undefined || b === "") return -1;
  return typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), undefined, { numeric: true });
}

function cellText(value) {
  if (value === null || value === undefined) return "";
  if (value === true || value === false) return value ? "yes" : "no";
  return String(value);
}
