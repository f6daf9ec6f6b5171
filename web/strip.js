"use strict";
// Charts of planrunner's pages, made with uPlot. All texts are set as text, never as markup.

const strips = (() => {
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const digits = (value, places = 7) => (value === null || value === undefined || !Number.isFinite(value) ? "–" : String(Number(value.toPrecision(places))));

  // A value with the decimals of the second significant digit of its uncertainty (GUM 7.2.6).
  const rounded = (value, uncertainty) => {
    if (!Number.isFinite(value) || value === null || !Number.isFinite(uncertainty) || !(uncertainty > 0)) return digits(value);
    const places = 1 - Math.floor(Math.log10(uncertainty));
    if (places < 0 || places > 6) return digits(value, Math.max(2, Math.min(17, places + 1 + Math.floor(Math.log10(Math.abs(value) || uncertainty)))));
    return value.toFixed(places);
  };

  const axis = (more) => ({
    stroke: colour("--soft"),
    grid: { stroke: colour("--rule"), width: 1 },
    ticks: { stroke: colour("--rule"), width: 1 },
    font: "12px system-ui, sans-serif",
    ...more,
  });

  // A short number for each mark of an axis, with as many digits as the distance of the marks needs.
  const marks = (_, values) => {
    const step = values.length > 1 ? Math.abs(values[1] - values[0]) : 1;
    const places = Math.max(0, Math.min(12, -Math.floor(Math.log10(step) + 1e-9)));
    const large = Math.max(...values.map(Math.abs));
    return values.map((value) => (large >= 1e6 || (large > 0 && large < 1e-4) ? value.toExponential(Math.max(0, Math.min(6, Math.ceil(Math.log10(large / step))))) : value.toFixed(places)));
  };

  // Least, greatest and mean value of a channel over time, in s.
  const strip = (host, height) => {
    let chart = null;
    const make = (data) => {
      chart = new uPlot(
        {
          width: Math.max(160, host.clientWidth),
          height,
          legend: { show: false },
          cursor: { show: false },
          scales: { x: { time: false } },
          axes: [axis({ size: 30, values: marks }), axis({ size: 76, values: marks })],
          series: [
            {},
            { stroke: colour("--band"), width: 1, points: { show: false } },
            { stroke: colour("--band"), width: 1, points: { show: false } },
            { stroke: colour("--line"), width: 1.5, points: { show: false } },
          ],
          bands: [{ series: [2, 1], fill: colour("--band") }],
        },
        data,
        host,
      );
    };
    return {
      set(data) {
        if (chart === null) make(data);
        else chart.setData(data);
      },
      fit() {
        if (chart !== null) chart.setSize({ width: Math.max(160, host.clientWidth), height });
      },
      repaint(data) {
        if (chart !== null) chart.destroy();
        make(data);
      },
    };
  };

  return { strip, axis, marks, colour, digits, rounded };
})();
