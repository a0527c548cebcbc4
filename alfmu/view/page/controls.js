// Controls for inputs, parameters and start values; the file of a run, and the command that repeats it.

const POSITIONS = 200; // largest number of positions of a slider

function change(reference, value, from) {
  values.set(reference, value);
  (controls.get(reference) || []).forEach((control) => { if (control !== from) control.tell(value); });
  tellCommand();
}

function number(text) {
  const value = Number(text);
  return text.trim() !== "" && Number.isFinite(value) ? value : null;
}

function control(reference, act) {
  const v = variables[reference], box = document.createElement("div"), label = document.createElement("label");
  const own = [], id = `v${reference}`, unit = v.unit && v.unit !== "1" ? v.unit : "";
  box.className = "control";
  label.htmlFor = id;
  label.append(v.label || v.name);
  if (unit) {
    const small = document.createElement("small");
    small.textContent = ` [${unit}]`;
    label.append(small);
  }
  box.append(label);
  const say = (value, from) => { change(reference, value, from); act(); };
  if (v.type === "Boolean") {
    const check = Object.assign(document.createElement("input"), { type: "checkbox", id });
    check.addEventListener("change", () => say(Number(check.checked)));
    own.push({ tell: (value) => { check.checked = Boolean(value); } });
    box.append(check);
  } else {
    const field = Object.assign(document.createElement("input"), { type: "number", step: "any", id: v.range ? `${id}n` : id });
    if (v.range) field.setAttribute("aria-label", `${v.name} as a number, ${unit}`);
    if (v.minimum !== null) field.min = v.minimum;
    if (v.maximum !== null) field.max = v.maximum;
    const numeric = { tell: (value) => { field.value = Number(Number(value).toPrecision(7)); } };
    field.addEventListener("change", () => {
      const value = number(field.value);
      const low = v.minimum ?? -Infinity, high = v.maximum ?? Infinity;
      if (value === null || value < low || value > high || (v.type === "Integer" && value !== Math.round(value))) {
        numeric.tell(values.get(reference));
        return;
      }
      say(value, numeric);
    });
    own.push(numeric);
    box.append(field);
    if (v.range) {
      const [low, high] = v.range, apart = nice((high - low) / POSITIONS), last = Math.ceil((high - low) / apart - 1e-9);
      const slider = Object.assign(document.createElement("input"), { type: "range", id, min: 0, max: last, step: 1 });
      const digits = Math.max(0, Math.min(15, -Math.floor(Math.log10(apart) + 1e-9)));
      const sliding = { tell: (value) => {
        slider.value = Math.round(last * (value - low) / (high - low));
        slider.setAttribute("aria-valuetext", `${Number(Number(value).toPrecision(4))} ${unit}`.trim());
      } };
      slider.addEventListener("input", () => {
        const raw = low + (high - low) * Number(slider.value) / last;
        const value = Math.min(v.maximum ?? Infinity, Math.max(v.minimum ?? -Infinity, Number(raw.toFixed(digits))));
        say(value, sliding);
        slider.setAttribute("aria-valuetext", `${value} ${unit}`.trim());
      });
      own.push(sliding);
      box.append(slider);
    }
  }
  if (v.description) {
    const text = Object.assign(document.createElement("p"), { className: "about", textContent: v.description, id: `${id}d` });
    box.append(text);
    box.querySelectorAll("input").forEach((input) => input.setAttribute("aria-describedby", text.id));
  }
  controls.set(reference, own);
  own.forEach((each) => each.tell(values.get(reference)));
  return box;
}

function makeControls() {
  const form = find("controls");
  const sections = [["Inputs", ["input", "switch"], () => {}, true], ["Start", ["start", "rate"], begin, true],
    ["Parameters", ["parameter"], begin, true], ["Compliances", ["compliance"], begin, false], ["Solver", ["solver"], begin, false]];
  const narrow = matchMedia("(max-width: 860px)").matches;
  for (const [title, kinds, act, open] of sections) {
    const own = variables.flatMap((v, reference) => (kinds.includes(v.kind) ? [reference] : []));
    if (!own.length) continue;
    const details = document.createElement("details"), summary = document.createElement("summary");
    details.open = open && !(narrow && title !== "Inputs");
    summary.textContent = title;
    details.append(summary, ...own.map((reference) => control(reference, act)));
    form.append(details);
  }
  const button = Object.assign(document.createElement("button"), { type: "button", id: "defaults", textContent: "All defaults" });
  button.addEventListener("click", () => {
    variables.forEach((v, reference) => { if (controls.has(reference)) change(reference, v.start); });
    picture.refit();
    begin();
  });
  form.append(button);
}

// Return the command line that makes this run.
function tellCommand() {
  const text = variables.flatMap((v, reference) => {
    const value = values.get(reference);
    return v.kind === "output" || value === v.start || ["input", "switch"].includes(v.kind) ? [] : [` --set ${v.name}=${value}`];
  });
  const own = variables.flatMap((v, reference) => (
    ["input", "switch"].includes(v.kind) && values.get(reference) !== v.start ? [reference] : []));
  own.forEach((reference) => driven.add(reference));
  find("inputs").hidden = !driven.size;
  find("command").textContent = about.command + text.join("") + (driven.size ? ` --input ${about.name}_inputs.csv` : "");
}

const driven = new Set(); // inputs changed by the user

// Return the rows so far (time, outputs, inputs) with all digits. `some` selects columns.
function csv(some = () => true) {
  const write = (x) => (Number.isNaN(x) ? "nan" : Number.isFinite(x) ? String(x) : x > 0 ? "inf" : "-inf");
  const quoted = (name) => (/[",\n]/.test(name) ? `"${name.replaceAll('"', '""')}"` : name);
  const chosen = about.shown.flatMap((reference, column) => (some(variables[reference]) ? [column] : []));
  const names = chosen.map((column) => quoted(variables[about.shown[column]].name));
  const lines = run.rows.map(({ time, row }) => [time, ...chosen.map((column) => row[column])].map(write).join(","));
  return [["time", ...names].join(","), ...lines].join("\r\n") + "\r\n";
}

function save(text, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
