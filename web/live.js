"use strict";
// The live page: takes the activity of the archive as server-sent events, and sends pauses and answers. Texts of runs are set as text only.

(() => {
  const KEPT = "planrunner token";
  const HEIGHT = 150;
  const find = (id) => document.getElementById(id);

  const token = (() => {
    const given = location.hash.slice(1);
    if (given) {
      sessionStorage.setItem(KEPT, given);
      history.replaceState(null, "", location.pathname);
    }
    return sessionStorage.getItem(KEPT) || "";
  })();

  const make = (tag, { text, cls, ...attributes } = {}, ...children) => {
    const made = document.createElement(tag);
    if (text !== undefined) made.textContent = text;
    if (cls) made.className = cls;
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    made.append(...children);
    return made;
  };
  const put = (node, text) => {
    if (node.textContent !== text) node.textContent = text;
  };
  const say = (text) => put(find("said"), text);

  const duration = (seconds) => {
    if (seconds === null) return "time left unknown";
    const whole = seconds < 60 ? Math.round(seconds) : 60 * Math.round(seconds / 60);
    const [days, hours, minutes] = [Math.floor(whole / 86400), Math.floor((whole % 86400) / 3600), Math.floor((whole % 3600) / 60)];
    const parts = [[days, "d"], [hours, "h"], [minutes, "min"], [whole % 60, "s"]].filter(([count]) => count);
    return `about ${parts.map(([count, unit]) => `${count} ${unit}`).join(" ") || "0 s"} left`;
  };
  const clock = (at) => at.slice(0, 19).replace("T", " ");

  // -- actions --------------------------------------------------------------------------------------------------------

  const problem = (text) => {
    put(find("problem"), text);
    find("problem").hidden = !text;
  };

  const act = async (name, body) => {
    try {
      const answer = await fetch(`/api/${name}`, {
        method: "POST",
        headers: { Authorization: `Bearer ${token}`, "Content-Type": "application/json" },
        body: JSON.stringify(body),
      });
      const told = await answer.json();
      problem(answer.ok ? "" : `Not done: ${told.error}`);
      return answer.ok;
    } catch {
      problem("Not done: the server does not answer.");
      return false;
    }
  };

  // -- one running run ------------------------------------------------------------------------------------------------

  let number = 0;

  class RunView {
    constructor(run) {
      this.run = run.run;
      this.id = `run-${++number}`;
      this.strips = new Map();
      this.question = null;
      this.last = run;
      this.title = make("h2", { id: this.id });
      this.about = make("p", { cls: "soft" });
      this.button = make("button", { type: "button" });
      this.button.addEventListener("click", async () => {
        this.button.disabled = true;
        await act(this.last.asked_to_pause ? "continue" : "pause", { run: this.run });
        this.button.disabled = false;
      });
      this.bar = make("progress", { max: "1", "aria-labelledby": this.id });
      this.place = make("span");
      this.left = make("span");
      this.activity = make("span", { cls: "soft" });
      this.prompt = make("div", { cls: "prompt", role: "alert" });
      this.prompt.hidden = true;
      this.rows = make("tbody");
      this.table = make(
        "table",
        {},
        make("caption", { text: "Channels in this segment" }),
        make(
          "thead",
          {},
          make(
            "tr",
            {},
            ...[["Channel"], ["Samples", 1], ["Mean", 1], ["Standard deviation", 1], ["Least", 1], ["Greatest", 1], ["Unit"]].map(([text, cls]) =>
              make("th", { text, scope: "col", cls: cls && "number" }),
            ),
          ),
        ),
        this.rows,
      );
      this.wide = make("div", { cls: "wide", tabindex: "0", role: "region", "aria-label": "Channels" }, this.table);
      this.charts = make("div", { cls: "strips" });
      this.hidden = make("p", { cls: "soft" });
      this.noticed = make("div");
      this.root = make(
        "article",
        { cls: "run", "aria-labelledby": this.id },
        make("header", {}, make("div", {}, this.title, this.about), this.button),
        this.bar,
        make("p", { cls: "now" }, this.place, this.left, this.activity),
        this.prompt,
        this.wide,
        this.hidden,
        this.charts,
        this.noticed,
      );
    }

    update(run) {
      this.last = run;
      const live = run.live;
      put(this.title, `${run.plan || run.run}${run.device ? `, device ${run.device}` : ""}`);
      put(this.about, `${run.started ? `since ${clock(run.started)} UTC` : ""}${run.operator ? `, operator ${run.operator}` : ""}, ${run.run}`);
      put(this.button, run.asked_to_pause ? (live.paused ? "Continue" : "Do not pause") : "Pause after this segment");
      this.button.setAttribute("aria-describedby", this.id);
      this.bar.value = live.fraction;
      put(this.bar, `${Math.floor(100 * live.fraction)} %`);
      put(this.place, live.segment.label ? `Segment ${live.segment.index + 1} of ${live.segment.of}: ${live.segment.label}` : `${live.segment.of} segments`);
      put(this.left, live.paused || live.question ? "" : `${Math.floor(100 * live.fraction)} %, ${duration(live.time_left_s)}`);
      put(this.activity, run.asked_to_pause && !live.paused ? `${live.activity} (pauses after this segment)` : live.activity);
      this.ask(live.question);
      this.channels(live);
      this.notices(live.notices);
    }

    ask(question) {
      const shown = question === null ? null : question.id;
      if (shown === this.question) return;
      this.question = shown;
      this.prompt.hidden = shown === null;
      this.prompt.replaceChildren();
      if (question === null) return;
      const name = `${this.id}-name`;
      const by = make("input", { id: name, type: "text", maxlength: "100", required: "", autocomplete: "name" });
      by.value = sessionStorage.getItem("planrunner name") || "";
      const done = make("button", { type: "submit", cls: "main", text: "Done: continue the run" });
      const form = make("form", {}, make("label", { for: name, text: "Your name" }), by, done);
      form.addEventListener("submit", async (event) => {
        event.preventDefault();
        sessionStorage.setItem("planrunner name", by.value);
        done.disabled = true;
        if (!(await act("answer", { run: this.run, question: question.id, by: by.value }))) done.disabled = false;
      });
      this.prompt.append(make("h3", { text: "The run waits for you" }), make("p", { text: question.text }), form);
    }

    channels(live) {
      this.wide.hidden = this.charts.hidden = live.channels.length === 0;
      put(this.hidden, live.hidden_channels ? `${live.hidden_channels} more channels are recorded, but not shown here.` : "");
      const { digits } = strips;
      live.channels.forEach((channel, place) => {
        const cells = [channel.name, String(channel.count), digits(channel.mean), digits(channel.standard_deviation, 4), digits(channel.least), digits(channel.greatest), channel.unit];
        let row = this.rows.children[place];
        if (!row) {
          row = make("tr", {}, make("th", { scope: "row" }), ...cells.slice(1).map((_, index) => make("td", { cls: index < 5 ? "number" : "" })));
          this.rows.append(row);
        }
        cells.forEach((text, index) => put(row.children[index], text));
        this.draw(channel, live.strip_time_s, place);
      });
      while (this.rows.children.length > live.channels.length) this.rows.lastChild.remove();
    }

    draw(channel, time, place) {
      let held = this.strips.get(place);
      if (!held) {
        const caption = make("figcaption");
        const host = make("div", { role: "img" });
        this.charts.append(make("figure", {}, caption, host));
        held = { caption, host, strip: strips.strip(host, HEIGHT), data: null };
        this.strips.set(place, held);
      }
      put(held.caption, `${channel.name}${channel.unit ? `, ${channel.unit}` : ""}, over the sensor's time in s`);
      held.host.setAttribute("aria-label", `${channel.name}: course of mean and extremes; the table above gives the numbers`);
      held.data = [time, channel.strip.least, channel.strip.greatest, channel.strip.mean];
      if (time.length > 1) held.strip.set(held.data);
    }

    notices(list) {
      const text = JSON.stringify(list);
      if (text === this.noticedText) return;
      this.noticedText = text;
      this.noticed.replaceChildren();
      if (!list.length) return;
      const items = list.map((one) => make("li", { text: `${clock(one.at)} UTC: ${one.text}` })).reverse();
      this.noticed.append(make("h3", { text: "Noticed" }), make("ul", { cls: "notices" }, ...items));
    }

    fit() {
      for (const held of this.strips.values()) held.strip.fit();
    }

    repaint() {
      for (const held of this.strips.values()) if (held.data && held.data[0].length > 1) held.strip.repaint(held.data);
    }
  }

  // -- the page -------------------------------------------------------------------------------------------------------

  const views = new Map();
  const running = find("running");

  const show = (activity) => {
    const present = new Set(activity.running.map((run) => run.run));
    for (const [name, view] of views) {
      if (present.has(name)) continue;
      view.root.remove();
      views.delete(name);
      say(`The run of ${view.title.textContent} has ended.`);
    }
    for (const run of activity.running) {
      let view = views.get(run.run);
      if (!view) {
        view = new RunView(run);
        views.set(run.run, view);
        running.append(view.root);
      }
      view.update(run);
    }
    let none = find("none");
    if (views.size === 0 && !none) running.append(make("p", { id: "none", text: "No run is in progress." }));
    else if (views.size && none) none.remove();
    recent(activity.recent);
    const waiting = activity.running.filter((run) => run.live.question).length;
    document.title = `${waiting ? `(${waiting} waiting) ` : ""}planrunner: ${activity.running.length} running`;
  };

  const STATES = { finished: ["finished", "mark good"], "not finished": ["not finished", "mark bad"], unreadable: ["unreadable", "mark bad"] };
  let recentText = "";
  const recent = (list) => {
    const text = JSON.stringify(list);
    if (text === recentText) return;
    recentText = text;
    if (!list.length) find("recent").replaceChildren(make("tr", {}, make("td", { text: "This archive has no other run.", colspan: "6" })));
    else
      find("recent").replaceChildren(
      ...list.map((run) => {
        const [word, cls] = STATES[run.outcome];
        const state = make("td", {}, make("span", { text: word, cls }));
        if (run.reason) state.append(make("br"), make("span", { text: run.reason, cls: "soft" }));
        return make(
          "tr",
          {},
          make("td", { text: run.started ? clock(run.started) : "–" }),
          make("td", { text: run.plan || "–" }),
          make("td", { text: run.device || "–" }),
          state,
          make("td", { text: String(run.segments), cls: "number" }),
          make("th", { text: run.run, scope: "row" }),
        );
      }),
    );
  };

  const connected = (text, cls) => {
    put(find("connection"), text);
    find("connection").className = cls;
  };

  // An EventSource cannot send the token in a header, so the stream is read by fetch.
  const listen = async () => {
    const answer = await fetch("/api/events", { headers: { Authorization: `Bearer ${token}` } });
    if (!answer.ok) {
      const told = await answer.json();
      connected(told.error, "bad");
      return answer.status !== 401;
    }
    connected("Connected", "soft");
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    let held = "";
    for (;;) {
      const { value, done } = await reader.read();
      if (done) return true;
      held += value;
      let end;
      while ((end = held.indexOf("\n\n")) >= 0) {
        const block = held.slice(0, end);
        held = held.slice(end + 2);
        if (block.startsWith("data: ")) show(JSON.parse(block.slice(6)));
      }
    }
  };

  const follow = async () => {
    for (;;) {
      let again = true;
      try {
        again = await listen();
        if (again) connected("The connection was lost. Reconnecting …", "bad");
      } catch {
        connected("The server does not answer. The page may be out of date. Reconnecting …", "bad");
      }
      if (!again) return;
      await new Promise((resolve) => setTimeout(resolve, 2000));
    }
  };

  let fitting = 0;
  addEventListener("resize", () => {
    cancelAnimationFrame(fitting);
    fitting = requestAnimationFrame(() => views.forEach((view) => view.fit()));
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => views.forEach((view) => view.repaint()));
  follow();
})();
