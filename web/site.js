"use strict";
// The site of an archive. Data arrive as scripts, because a page from a file share may not read files. All texts are set as text.

(() => {
  const RUN = ["folder", "created", "plan", "title", "device", "bench", "operator", "verdict", "state", "analysis", "warnings", "origin", "reports"];
  const PAGE = 100;
  const VERDICTS = {
    pass: ["limits met", "good"],
    warned: ["limits met, with warnings", "care"],
    fail: ["limit not met", "bad"],
    none: ["no limits", "soft"],
    "not analysed": ["not analysed", "care"],
  };
  const find = (id) => document.getElementById(id);
  const { digits, rounded, axis, marks, colour } = strips;

  const make = (tag, { text, cls, ...attributes } = {}, ...children) => {
    const made = document.createElement(tag);
    if (text !== undefined) made.textContent = text;
    if (cls) made.className = cls;
    for (const [name, value] of Object.entries(attributes)) if (value !== undefined) made.setAttribute(name, value);
    made.append(...children);
    return made;
  };
  const moment = (at) => at.slice(0, 16).replace("T", " ");

  // -- data -----------------------------------------------------------------------------------------------------------

  const waiting = new Map();
  const held = new Map();
  globalThis.planrunnerData = (name, value) => {
    held.set(name, value);
    if (waiting.has(name)) waiting.get(name)(value);
  };
  const load = (name, address) =>
    new Promise((resolve, reject) => {
      if (held.has(name)) return resolve(held.get(name));
      waiting.set(name, resolve);
      const script = make("script", { src: address });
      script.onerror = () => reject(new Error(`The file ${address} of this site cannot be read. Make the site again with planrunner site.`));
      document.head.append(script);
    });

  let entry;
  const runs = [];
  let rest = null;
  const everything = () => (rest instanceof Promise ? rest : (rest = rest()));

  const start = async () => {
    entry = await load("entry", "data.js");
    const take = (chunk) => {
      for (const row of chunk) {
        const run = { place: runs.length };
        RUN.forEach((name, index) => (run[name] = row[index]));
        run.words = [run.plan, run.title, run.device, run.bench, run.operator, run.folder, run.origin].join("\n").toLowerCase();
        runs.push(run);
      }
    };
    // The newest runs are in the first file: the first page does not wait for the others.
    if (entry.chunks) take(await load("runs-0", `${entry.data}/runs-0.js`));
    rest = async () => {
      for (let number = 1; number < entry.chunks; number += 1) take(await load(`runs-${number}`, `${entry.data}/runs-${number}.js`));
    };
    find("archive").textContent = `planrunner, archive ${entry.archive}`;
    find("made").textContent = `${entry.runs} runs, ${entry.devices.length} devices. Made by planrunner ${entry.version}. Times are UTC.`;
    addEventListener("hashchange", () => route(true));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => route(false));
    await route(false);
    await everything();
  };

  // -- parts ----------------------------------------------------------------------------------------------------------

  const verdict = (run) => {
    const [words, cls] = VERDICTS[run.verdict] || [run.verdict, "soft"];
    const parts = [make("span", { text: words, cls: `mark ${cls}` })];
    if (run.state !== "sealed") parts.push(make("br"), make("span", { text: "run not finished", cls: "mark bad" }));
    if (run.warnings) parts.push(make("br"), make("span", { text: `${run.warnings} warning${run.warnings > 1 ? "s" : ""}`, cls: "soft" }));
    return parts;
  };
  const way = (...parts) => parts.flatMap((part) => String(part).split("/")).map(encodeURIComponent).join("/");
  const deviceLink = (device) => (device ? make("a", { text: device, href: `#/device/${encodeURIComponent(device)}` }) : make("span", { text: "–" }));
  const reports = (run) => {
    if (entry.link === null || !run.reports.length) return [document.createTextNode("–")];
    return run.reports.flatMap((name, index) => [
      ...(index ? [document.createTextNode(", ")] : []),
      make("a", { text: name, href: `${entry.link}/${way(run.folder, "analyses", run.analysis, name)}` }),
    ]);
  };
  const table = (caption, titles, rows) =>
    make(
      "div",
      { cls: "wide", tabindex: "0", role: "region", "aria-label": caption },
      make(
        "table",
        {},
        make("caption", { text: caption }),
        make("thead", {}, make("tr", {}, ...titles.map(([text, cls]) => make("th", { text, scope: "col", cls })))),
        make("tbody", {}, ...rows),
      ),
    );
  const cell = (content, cls) => make("td", { cls }, ...(Array.isArray(content) ? content : [content]));
  const RUN_TITLES = [["Started"], ["Verdict"], ["Device"], ["Plan"], ["Bench"], ["Reports"], ["Run folder"]];
  const runRow = (run) =>
    make(
      "tr",
      {},
      cell(moment(run.created), "when"),
      cell(verdict(run)),
      cell(deviceLink(run.device)),
      cell(run.title || run.plan || "–"),
      cell(run.bench || "–"),
      cell(reports(run)),
      make("th", { text: run.folder, scope: "row" }),
    );
  const counted = (list) => {
    const order = ["fail", "not analysed", "warned", "none", "pass"];
    return make(
      "ul",
      { cls: "counts" },
      ...order
        .map((kind) => [kind, list.filter((run) => run.verdict === kind).length])
        .filter(([, count]) => count)
        .map(([kind, count]) => make("li", {}, make("strong", { text: String(count), cls: VERDICTS[kind][1] }), document.createTextNode(` ${VERDICTS[kind][0]}`))),
    );
  };

  // -- pages ----------------------------------------------------------------------------------------------------------

  const STATES = {
    failed: ["limit not met", "bad"],
    fault: ["fault", "bad"],
    refused: ["refused", "bad"],
    not_run: ["not run", "bad"],
    known_failure: ["known failure", "care"],
    running: ["running", "care"],
    waiting: ["waiting", "care"],
    passed: ["passed", "good"],
  };
  const ORDER = Object.keys(STATES);

  const standingMark = (standing) => make("span", { text: standing, cls: `mark ${standing === "in control" ? "good" : "bad"}` });

  // What a night was to do, and what became of it: also the tests that gave no run.
  const nightWall = (night) => {
    const rows = [...night.tests]
      .sort((a, b) => ORDER.indexOf(a[3]) - ORDER.indexOf(b[3]))
      .map(([test, device, bench, state, reason, run]) =>
        make(
          "tr",
          {},
          make("th", { text: test, scope: "row" }),
          cell(deviceLink(device)),
          cell(bench),
          cell([make("span", { text: STATES[state][0], cls: `mark ${STATES[state][1]}` })]),
          cell(reason || "–", "words"),
          cell(run ? [make("a", { text: run, href: `#/runs?${new URLSearchParams({ search: run })}` })] : "–"),
        ),
      );
    const counts = Object.entries(night.counts).map(([state, count]) =>
      make("li", {}, make("strong", { text: String(count), cls: STATES[state][1] }), document.createTextNode(` ${STATES[state][0]}`)),
    );
    const end = night.ends ? ` to ${night.ends.slice(0, 16).replace("T", " ")}` : "";
    const code = night.exit_code === null ? "" : `, exit code ${night.exit_code}`;
    const said = night.fleet.flatMap((group) => group.statements.map((text) => make("li", { text: `${text} (${group.plan}, ${group.runs} runs)` })));
    const standards = night.check_standards.map(([bench, device, standing, reasons]) =>
      make("tr", {}, make("th", { text: bench, scope: "row" }), cell(deviceLink(device)), cell([standingMark(standing)]), cell(reasons.join("; ") || "–", "words")),
    );
    return [
      make("p", { cls: "soft", text: `${night.title}: ${night.begins.slice(0, 16).replace("T", " ")}${end} local time, ${night.state}${code}` }),
      make("ul", { cls: "counts" }, ...counts),
      ...(said.length ? [make("h2", { text: "Fleet" }), make("ul", { cls: "said" }, ...said)] : []),
      ...(standards.length ? [table("Check standards that were measured first", [["Bench"], ["Check standard"], ["State"], ["Why"]], standards)] : []),
      table("Tests of the night, those that need attention first", [["Test"], ["Device"], ["Bench"], ["State"], ["Reason"], ["Run folder"]], rows),
      ...night.remarks.map((text) => make("p", { text })),
    ];
  };

  const lastNight = (query) => {
    const night = runs.filter((run) => run.created >= entry.night_since);
    const parts = [make("h1", { text: "Last night" })];
    if (entry.nights.length) {
      const host = make("div");
      const names = entry.nights.map((one) => one.night);
      const chosen = names.includes(query.get("night")) ? query.get("night") : names[0];
      const select = make("select", { id: "night" }, ...entry.nights.map((one) => make("option", { value: one.night, text: `${one.begins.slice(0, 10)}, ${one.title}` })));
      select.value = chosen;
      const show = () => host.replaceChildren(...nightWall(entry.nights[names.indexOf(select.value)]));
      select.addEventListener("input", show);
      show();
      parts.push(make("div", { cls: "field" }, make("label", { for: "night", text: "Night" }), select), host, make("h2", { text: "All runs of the last 24 hours" }));
    }
    if (!night.length) parts.push(make("p", { text: "This archive has no runs." }));
    else {
      parts.push(make("p", { cls: "soft", text: `Runs of the 24 hours up to ${moment(night[0].created)} UTC.` }), counted(night));
      const rank = { fail: 0, "not analysed": 1, warned: 2, none: 3, pass: 4 };
      const weight = (run) => (run.state === "sealed" ? 0 : -5) + rank[run.verdict];
      const sorted = [...night].sort((a, b) => weight(a) - weight(b) || a.place - b.place);
      const shown = sorted.slice(0, 500);
      parts.push(table("Runs, those that need attention first", RUN_TITLES, shown.map(runRow)));
      if (sorted.length > shown.length) parts.push(make("p", { text: `${sorted.length - shown.length} more are under Runs.` }));
    }
    if (entry.faults.length) {
      const rows = entry.faults.slice(0, 200).map(([folder, message]) => make("tr", {}, make("th", { text: folder, scope: "row" }), cell(message)));
      parts.push(make("h2", { text: "Folders that could not be read" }), table("Folders that could not be read, with the reason", [["Folder"], ["Reason"]], rows));
    }
    return parts;
  };

  const choice = (id, label, values, chosen, words = (value) => value) => {
    const select = make("select", { id });
    select.append(make("option", { value: "", text: "all" }), ...values.map((value) => make("option", { value, text: words(value) })));
    select.value = chosen;
    return [make("div", { cls: "field" }, make("label", { for: id, text: label }), select), select];
  };
  const distinct = (name) => [...new Set(runs.map((run) => run[name]))].filter(Boolean).sort();

  const allRuns = (query) => {
    const search = make("input", { id: "search", type: "search" });
    search.value = query.get("search") || "";
    const [planField, plan] = choice("plan", "Plan", distinct("plan"), query.get("plan") || "");
    const [benchField, bench] = choice("bench", "Bench", distinct("bench"), query.get("bench") || "");
    const [verdictField, kind] = choice("verdict", "Verdict", Object.keys(VERDICTS), query.get("verdict") || "", (value) => VERDICTS[value][0]);
    const form = make("form", { cls: "filters", role: "search" }, make("div", { cls: "field" }, make("label", { for: "search", text: "Search" }), search), planField, benchField, verdictField);
    form.addEventListener("submit", (event) => event.preventDefault());
    const told = make("p", { role: "status" });
    const host = make("div");
    const before = make("button", { type: "button", text: "Newer" });
    const after = make("button", { type: "button", text: "Older" });
    let first = 0;
    const show = () => {
      const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
      const found = runs.filter(
        (run) =>
          (!plan.value || run.plan === plan.value) &&
          (!bench.value || run.bench === bench.value) &&
          (!kind.value || run.verdict === kind.value) &&
          words.every((word) => run.words.includes(word)),
      );
      first = Math.max(0, Math.min(first, PAGE * Math.floor((found.length - 1) / PAGE)));
      const shown = found.slice(first, first + PAGE);
      told.textContent = found.length ? `${found.length} ${found.length === 1 ? "run" : "runs"}; ${first + 1} to ${first + shown.length} are shown, the newest first` : "No run matches.";
      host.replaceChildren(table("Runs", RUN_TITLES, shown.map(runRow)));
      before.disabled = first === 0;
      after.disabled = first + PAGE >= found.length;
      const now = new URLSearchParams();
      for (const [name, field] of [["search", search], ["plan", plan], ["bench", bench], ["verdict", kind]]) if (field.value) now.set(name, field.value);
      const text = now.toString();
      history.replaceState(null, "", `#/runs${text ? `?${text}` : ""}`);
    };
    const anew = () => {
      first = 0;
      show();
    };
    for (const field of [search, plan, bench, kind]) field.addEventListener("input", anew);
    before.addEventListener("click", () => ((first -= PAGE), show()));
    after.addEventListener("click", () => ((first += PAGE), show()));
    show();
    return [make("h1", { text: "Runs" }), form, told, host, make("p", { cls: "pages" }, before, after)];
  };

  const grouped = (name) => {
    const groups = new Map();
    for (const run of runs) if (run[name]) groups.has(run[name]) ? groups.get(run[name]).push(run) : groups.set(run[name], [run]);
    return [...groups].sort(([a], [b]) => (a < b ? -1 : 1));
  };
  const overview = (title, column, name, link) => {
    const groups = grouped(name);
    const host = make("div");
    const search = make("input", { id: "search", type: "search" });
    const told = make("p", { role: "status" });
    const show = () => {
      const found = groups.filter(([value]) => value.toLowerCase().includes(search.value.toLowerCase()));
      const rows = found.slice(0, 500).map(([value, list]) =>
        make("tr", {}, make("th", { scope: "row" }, link(value)), cell(String(list.length), "number"), cell(String(list.filter((run) => run.verdict === "fail").length), "number"), cell(moment(list[0].created)), cell(verdict(list[0]))),
      );
      told.textContent = `${found.length} of ${groups.length}${found.length > 500 ? "; the first 500 are shown" : ""}`;
      host.replaceChildren(table(title, [[column], ["Runs", "number"], ["Limit not met", "number"], ["Last run"], ["Last verdict"]], rows));
    };
    search.addEventListener("input", show);
    show();
    return [make("h1", { text: title }), make("div", { cls: "field" }, make("label", { for: "search", text: `Search ${title.toLowerCase()}` }), search), told, host];
  };

  const benches = () => {
    const link = (value) => make("a", { text: value, href: `#/runs?${new URLSearchParams({ bench: value })}` });
    const parts = overview("Benches", "Bench", "bench", link);
    const rows = entry.standards.map((one) =>
      make(
        "tr",
        {},
        make("th", { scope: "row" }, link(one.bench)),
        cell(deviceLink(one.device)),
        cell([standingMark(one.standing)]),
        cell(one.created === null ? "–" : moment(one.created), "when"),
        cell(one.reasons.join("; ") || one.coefficients.map((own) => `${own.quantity} ${digits(own.value, 6)} ${own.unit}`).join("; "), "words"),
      ),
    );
    if (rows.length)
      parts.push(
        make("h2", { text: "Check standards" }),
        make("p", { cls: "soft", text: "State when this site was made." }),
        table("Check standards of the benches", [["Bench"], ["Check standard"], ["State"], ["Newest run"], ["Why, or the newest values"]], rows),
      );
    return parts;
  };

  const device = async (name) => {
    const number = entry.devices.indexOf(name);
    if (number < 0) return [make("h1", { text: "Unknown device" }), make("p", { text: `This archive has no device ${name}.` })];
    const series = await load(`device-${number}`, `${entry.data}/device-${number}.js`);
    const own = runs.filter((run) => run.device === name);
    const parts = [make("h1", { text: `Device ${name}` }), counted(own)];
    if (series.length) {
      const select = make("select", { id: "quantity" });
      series.forEach((one, index) => select.append(make("option", { value: String(index), text: `${one.quantity}${one.unit ? `, ${one.unit}` : ""}` })));
      const host = make("div");
      select.addEventListener("input", () => course(host, series[Number(select.value)]));
      parts.push(make("h2", { text: "Coefficients over time" }), make("div", { cls: "field" }, make("label", { for: "quantity", text: "Coefficient" }), select), host);
      later.push(() => course(host, series[0]));
    }
    const titles = new Set(own.map((run) => run.title || run.plan));
    const latest = entry.nights.find((night) => night.fleet.length);
    const said = latest ? latest.fleet.filter((group) => titles.has(group.plan)).flatMap((group) => group.statements) : [];
    if (said.length) {
      parts.push(make("h2", { text: "Fleet" }), make("p", { cls: "soft", text: `Diagnosis of all runs of the same plans, night of ${latest.begins.slice(0, 10)}.` }));
      parts.push(make("ul", { cls: "said" }, ...said.map((text) => make("li", { text }))));
    }
    parts.push(make("h2", { text: "Runs of this device" }), table("Runs, the newest first", RUN_TITLES, own.slice(0, 500).map(runRow)));
    return parts;
  };

  const days = (_, moments) => {
    const whole = moments.length < 2 || moments[1] - moments[0] >= 86400;
    return moments.map((seconds) => new Date(1000 * seconds).toISOString().slice(whole ? 0 : 5, whole ? 10 : 16).replace("T", " "));
  };

  // A coefficient over time: values with U = 2u, the limits of the plans, and the control limits.
  const course = (host, one) => {
    const chart = make("div", { role: "img", "aria-label": `${one.quantity} over time; the table below gives the numbers` });
    const fit = (value, u, side) => (value === null ? null : value + side * 2 * (u || 0));
    const when = one.run.map((place) => Date.parse(runs[place].created) / 1000);
    const low = one.value.map((value, index) => fit(value, one.u[index], -1));
    const high = one.value.map((value, index) => fit(value, one.u[index], 1));
    const line = (name, cls, dash) => ({ label: name, stroke: colour(cls), dash, width: 1.5, points: { show: false }, spanGaps: true });
    const rows = one.run
      .map((place, index) => {
        const expanded = one.u[index] === null ? null : 2 * one.u[index];
        return make(
          "tr",
          {},
          make("th", { text: moment(runs[place].created), scope: "row" }),
          cell(rounded(one.value[index], expanded), "number"),
          cell(rounded(expanded, expanded), "number"),
          cell(digits(one.plan_lower[index], 6), "number"),
          cell(digits(one.plan_upper[index], 6), "number"),
          cell(rounded(one.control_lower[index], expanded), "number"),
          cell(rounded(one.control_upper[index], expanded), "number"),
          cell(runs[place].bench || "–"),
          cell(verdict(runs[place])),
        );
      })
      .reverse();
    const titles = [["Run"], ["Value", "number"], ["U (k = 2)", "number"], ["Limit of the plan, lower", "number"], ["upper", "number"], ["Control limit, lower", "number"], ["upper", "number"], ["Bench"], ["Verdict"]];
    const unit = one.unit ? `, ${one.unit}` : "";
    const figure = (title, canvas) => make("figure", { cls: "chart" }, make("figcaption", { text: title }), canvas);
    const average = make("div", { role: "img", "aria-label": `Moving average of ${one.quantity}; ${alarms(one.ewma)}` });
    const sums = make("div", { role: "img", "aria-label": `Cumulative sums of ${one.quantity}; ${alarms(one.cusum_up, one.cusum_down)}` });
    const charted = one.ewma.value.some((value) => value !== null);
    const slow = [
      figure(`Moving average (EWMA)${unit}: ${alarms(one.ewma)}`, average),
      figure(`Cumulative sums (CUSUM), in standard deviations: ${alarms(one.cusum_up, one.cusum_down)}`, sums),
    ];
    host.replaceChildren(
      figure(`${one.quantity}${unit}`, chart),
      make("p", { cls: "soft", text: `Points: values. Band: U = 2u. Dashed: Shewhart control limits. Dotted: limits of the plans.${one.changes.length ? " Vertical lines: changes in level." : ""}` }),
      ...changeList(one),
      ...(charted ? [make("div", { cls: "strips" }, ...slow)] : []),
      table(`${one.quantity}${one.unit ? ` in ${one.unit}` : ""}, the newest first`, titles, rows.slice(0, 500)),
    );
    const between = one.changes.map((change) => (when[change.before] + when[change.after]) / 2);
    const draw = (place, height, series, data, bands) =>
      new uPlot(
        {
          width: Math.max(240, place.clientWidth),
          height,
          legend: { show: false },
          cursor: { show: false },
          tzDate: (seconds) => uPlot.tzDate(new Date(1000 * seconds), "Etc/UTC"),
          axes: [axis({ size: 34, space: 110, values: days }), axis({ size: 84, values: marks })],
          series: [{}, ...series],
          bands,
          hooks: { draw: [(plot) => upright(plot, between)] },
        },
        [when, ...data],
        place,
      );
    const control = () => line("control limit", "--care", [8, 5]);
    const limit = () => line("limit of the plan", "--bad", [2, 4]);
    const dots = (name, cls) => ({ label: name, stroke: colour(cls), width: 1, points: { show: true, size: 5, fill: colour(cls) } });
    draw(
      chart,
      320,
      [line("U", "--band"), line("U", "--band"), dots("value", "--line"), control(), control(), limit(), limit()],
      [low, high, one.value, one.control_lower, one.control_upper, one.plan_lower, one.plan_upper],
      [{ series: [2, 1], fill: colour("--band") }],
    );
    if (charted) {
      draw(average, 220, [dots("EWMA", "--line"), control(), control()], [one.ewma.value, one.ewma.lower, one.ewma.upper]);
      draw(
        sums,
        220,
        [dots("sum upwards", "--line"), dots("sum downwards", "--good"), control(), control()],
        [one.cusum_up.value, one.cusum_down.value, one.cusum_down.lower, one.cusum_up.upper],
      );
    }
  };

  // How many values of control charts are outside their limits, and whether the newest one is.
  const alarms = (...charts) => {
    const outside = (chart, index) => chart.value[index] !== null && (chart.value[index] < chart.lower[index] || chart.value[index] > chart.upper[index]);
    const places = charts[0].value.map((_, index) => charts.some((chart) => outside(chart, index)));
    const count = places.filter(Boolean).length;
    if (!count) return "all within the limits";
    return `${count} outside the limits${places[places.length - 1] ? ", also the newest" : ""}`;
  };

  // Dotted upright lines at these moments.
  const upright = (plot, moments) => {
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.strokeStyle = colour("--soft");
    ctx.setLineDash([3, 4]);
    ctx.lineWidth = 1.5;
    for (const at of moments) {
      const x = plot.valToPos(at, "x", true);
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
    }
    ctx.restore();
  };

  // Changes of the level, each with what else changed between the two runs.
  const changeList = (one) => {
    if (!one.changes.length) return [];
    const at = (index) => moment(runs[one.run[index]].created);
    const rows = one.changes.map((change) =>
      make(
        "tr",
        {},
        make("th", { text: `${at(change.before)} to ${at(change.after)}`, scope: "row" }),
        cell(`${digits(change.step, 4)} ± ${digits(2 * change.u, 2)}`, "number"),
        cell(change.p < 0.001 ? "< 0.001" : digits(change.p, 2), "number"),
        cell(
          change.causes.length
            ? [make("ul", { cls: "notices" }, ...change.causes.map(([words, before, after, shared]) => make("li", { text: `${words}: ${before || "none"} → ${after || "none"}${shared === 1 ? ", and so in all runs before and after" : ""}` })))]
            : "nothing that the runs record",
          "words",
        ),
      ),
    );
    return [table("Changes in level, and what else changed at the same time", [["Between the runs"], ["Step ± U", "number"], ["p", "number"], ["What else changed (possible causes)"]], rows)];
  };

  // -- which page -----------------------------------------------------------------------------------------------------

  const later = [];
  const route = async (moved) => {
    const [path, query = ""] = decodeHash();
    const enough = path === "/" && (runs.length === entry.runs || runs[runs.length - 1].created < entry.night_since);
    if (!enough) await everything();
    const parts =
      path === "/" ? lastNight(new URLSearchParams(query))
      : path === "/runs" ? allRuns(new URLSearchParams(query))
      : path === "/devices" ? overview("Devices", "Device", "device", deviceLink)
      : path === "/benches" ? benches()
      : path.startsWith("/device/") ? await device(decodeURIComponent(path.slice(8)))
      : [make("h1", { text: "Unknown page" })];
    find("main").replaceChildren(...parts);
    for (const act of later.splice(0)) act();
    for (const link of document.querySelectorAll("nav a")) {
      const here = link.getAttribute("href") === `#${path}` || (link.getAttribute("href") === "#/devices" && path.startsWith("/device/"));
      here ? link.setAttribute("aria-current", "page") : link.removeAttribute("aria-current");
    }
    const title = find("main").querySelector("h1").textContent;
    document.title = `${title}, planrunner`;
    if (moved) {
      find("main").focus();
      scrollTo(0, 0);
      find("said").textContent = title;
    }
  };
  const decodeHash = () => {
    const text = location.hash.slice(1) || "/";
    const cut = text.indexOf("?");
    return cut < 0 ? [text] : [text.slice(0, cut), text.slice(cut + 1)];
  };

  start().catch((error) => find("main").replaceChildren(make("p", { cls: "problem", role: "alert", text: error.message })));
})();
