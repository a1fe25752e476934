// The observations of a season as small multiples on one scale of days.

import { cursor, dayScale, MARGIN, months, runs, tick } from './chart.js';
import { drawn, h, s, show } from './dom.js';
import { counted, dayMonth, number, valueText, VARIABLES } from './text.js';

const HEIGHT = 104;
const TOP = 10;
const BOTTOM = HEIGHT - 18;

function range(variable, values) {
  let low = Math.min(...values, variable.floor ?? Infinity, variable.zero ? 0 : Infinity);
  let high = Math.max(...values, variable.ceiling ?? -Infinity, variable.zero ? 0 : -Infinity);
  if (!(high > low)) [low, high] = [low - 0.5, low + 0.5];
  return [low, high];
}

function shape(variable, scale, points, y) {
  const at = (point) => `${scale.x(point.date).toFixed(1)} ${y(point.value).toFixed(1)}`;
  const width = Math.max(0.8, scale.step - (scale.step > 3 ? 1 : 0.3));
  // a value of 0 still leaves a trace: it is no missing value
  const column = (date, top) => s('rect', { class: 'amount', x: scale.x(date) - width / 2, width, y: top, height: BOTTOM - top });
  if (variable.kind === 'flags') return points.map((point) => column(point.date, point.value ? TOP + 26 : BOTTOM - 1));
  if (variable.kind === 'bars') return points.map((point) => column(point.date, Math.min(y(point.value), BOTTOM - 1)));
  if (variable.kind === 'direction') return points.map((point) => s('circle', { class: 'dot', cx: scale.x(point.date), cy: y(point.value), r: 1.7 }));
  return runs(points).map((run) => (run.length === 1
    ? s('circle', { class: 'dot', cx: scale.x(run[0].date), cy: y(run[0].value), r: 1.4 })
    : s('path', { class: 'line', d: `M${run.map(at).join('L')}` })));
}

function axis(variable, low, high, y, width) {
  const line = (value) => s('line', { class: 'grid', x1: MARGIN.left, x2: width - MARGIN.right, y1: y(value), y2: y(value) });
  if (variable.kind === 'flags') return s('line', { class: 'grid', x1: MARGIN.left, x2: width - MARGIN.right, y1: BOTTOM, y2: BOTTOM });
  if (variable.kind === 'direction') return [['N', 360], ['W', 270], ['S', 180], ['E', 90], ['N', 0]].map(([name, degrees]) => [line(degrees), tick(name, y(degrees))]);
  const zero = variable.zero && low < 0 && high > 0;
  const values = zero && Math.min(-low, high) > (high - low) * 0.18 ? [low, 0, high] : [low, high];
  return [values.map((value) => [line(value), tick(number(value, high - low < 5 ? 1 : 0), y(value))]),
    zero && s('line', { class: 'zero', x1: MARGIN.left, x2: width - MARGIN.right, y1: y(0), y2: y(0) })];
}

function draw(name, season, selected, width) {
  const variable = VARIABLES[name];
  const scale = dayScale(season.first, season.last, width);
  const points = [...season.observations.values()].filter((day) => day[name] !== null).map((day) => ({ date: day.date, value: day[name] }));
  const [low, high] = variable.kind === 'flags' ? [0, 1] : range(variable, points.map((point) => point.value));
  const y = (value) => BOTTOM - ((value - low) / (high - low)) * (BOTTOM - TOP);
  const avalanches = [...season.activity].filter(([, activity]) => season.event(activity) === true)
    .map(([date]) => s('rect', { class: 'event', x: scale.x(date) - scale.step / 2, width: scale.step, y: TOP, height: BOTTOM - TOP }));
  const about = variable.kind === 'flags'
    ? `${points.filter((point) => point.value).length} of ${counted(points.length, 'day')}`
    : `from ${valueText(name, Math.min(...points.map((p) => p.value)))} to ${valueText(name, Math.max(...points.map((p) => p.value)))}`;
  return s('svg', { width, height: HEIGHT, class: 'chart', role: 'img', 'aria-label': `${variable.name}: ${about}; the values stand in the table of the season` },
    avalanches, axis(variable, low, high, y, width), months(scale, TOP, BOTTOM), cursor(scale, selected, TOP, BOTTOM), shape(variable, scale, points, y));
}

/** Draws a panel for each variable that the season has. */
export function drawObservations(place, season, { selected, lead }) {
  const day = season.observations.get(selected);
  show(place,
    h('h2', null, 'Observations'),
    season.variables.length === 0
      ? h('p', { class: 'muted' }, 'No weather or snow was recorded in this season.')
      : [
        h('p', { class: 'muted' }, `Beside the names: ${dayMonth(selected)}${lead > 0 ? ', the newest day that the forecast reads' : ''}. Shaded: avalanche days. A gap is a missing value.`),
        h('div', { class: 'multiples' }, season.variables.map((name) => h('figure', null,
          h('figcaption', null, h('span', null, VARIABLES[name].name, h('span', { class: 'muted' }, ` ${VARIABLES[name].about ?? VARIABLES[name].unit}`)),
            h('strong', null, valueText(name, day?.[name]))),
          drawn(h('div', { class: 'figure' }), (width) => draw(name, season, selected, width))))),
      ]);
}
