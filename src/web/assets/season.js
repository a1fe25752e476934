// The season: probability by day against the threshold, and what was recorded.

import { activityMark, cursor, dayScale, MARGIN, months, tick } from './chart.js';
import { drawn, h, s, show, table } from './dom.js';
import { ACTIVITIES, CATEGORIES, counted, MISSING, percent, seasonName, shortDay, valueText, variableName } from './text.js';

const HEIGHT = 250;
const TOP = 34;
const BOTTOM = HEIGHT - 22;

const y = (share) => BOTTOM - share * (BOTTOM - TOP);

function draw(season, selected, choose, width) {
  const right = width > 600 ? 70 : 40;
  const scale = dayScale(season.first, season.last, width, right);
  const threshold = season.forecasts[0]?.threshold;
  const gap = scale.step > 4 ? 1 : scale.step * 0.2;
  const bars = season.forecasts.map((day) => s('rect', {
    class: `bar ${day.category}`, x: scale.x(day.date) - (scale.step - gap) / 2, width: scale.step - gap,
    y: Math.min(y(day.probability), BOTTOM - 1), height: Math.max(1, BOTTOM - y(day.probability)),
  }, s('title', null, `${shortDay(day.date)}: ${percent(day.probability)}, recorded: ${ACTIVITIES[season.activity.get(day.date)] ?? 'no record'}`)));
  const marks = [...season.activity].map(([date, activity]) => activityMark(activity, scale.x(date), 20, Math.min(4.4, Math.max(2.2, scale.step * 0.6))));
  const [title, about] = ['season-chart-title', 'season-chart-about'];
  const svg = s('svg', { width, height: HEIGHT, role: 'img', 'aria-labelledby': title, 'aria-describedby': about, class: 'chart choosable' },
    s('title', { id: title }, `Probability of an avalanche day, season ${seasonName(season.year)}`),
    s('desc', { id: about }, summary(season)),
    [0, 0.25, 0.5, 0.75, 1].map((share) => [
      s('line', { class: 'grid', x1: MARGIN.left, x2: width - right, y1: y(share), y2: y(share) }), tick(`${share * 100} %`, y(share))]),
    months(scale, TOP, BOTTOM),
    cursor(scale, selected, 8, BOTTOM),
    bars,
    marks,
    threshold !== undefined && [
      s('line', { class: 'threshold', x1: MARGIN.left, x2: width - right, y1: y(threshold), y2: y(threshold) }),
      width > 600 && s('text', { class: 'threshold-text', x: width - right + 5, y: y(threshold) - 3 }, 'threshold'),
      s('text', { class: 'threshold-text', x: width - right + 5, y: y(threshold) + (width > 600 ? 11 : 4) }, percent(threshold))]);
  svg.addEventListener('click', (event) => choose(scale.dateAt(event.clientX - svg.getBoundingClientRect().left)));
  return svg;
}

/** The season in a sentence: what the chart shows, counted. */
function summary(season) {
  const avalanches = (date) => season.event(season.activity.get(date));
  const judged = season.forecasts.filter((day) => avalanches(day.date) !== null);
  const [warned, quiet] = [judged.filter((day) => day.category === 'avalanche_day'), judged.filter((day) => day.category !== 'avalanche_day')];
  const hits = warned.filter((day) => avalanches(day.date)).length;
  const missed = quiet.filter((day) => avalanches(day.date)).length;
  if (judged.length === 0) return 'No day of this season has both a forecast and a record of avalanches.';
  return `${counted(judged.length, 'day')} with a forecast and a record: ${counted(hits + missed, 'avalanche day')} with ${counted(hits, 'hit')} and `
    + `${counted(missed, 'miss', 'misses')}, and ${counted(warned.length - hits, 'false alarm')}, at the threshold of ${percent(judged[0].threshold)}.`;
}

const legend = () => h('ul', { class: 'legend' },
  [['bar avalanche_day', 'at or above the threshold'], ['bar no_avalanche_day', 'below it']].map(([name, text]) => h('li', null,
    s('svg', { width: 12, height: 12, 'aria-hidden': 'true' }, s('rect', { class: name, width: 12, height: 12 })), text)),
  ['observed', 'presumed', 'unknown'].map((activity) => h('li', null,
    s('svg', { width: 12, height: 12, 'aria-hidden': 'true' }, activityMark(activity, 6, 6)), activity === 'unknown' ? 'nobody could say' : ACTIVITIES[activity])));

function asTable(season, link) {
  const dates = [...new Set([...season.observations.keys(), ...season.forecasts.map((day) => day.date)])].sort();
  const forecasts = new Map(season.forecasts.map((day) => [day.date, day]));
  return table(`Days of the season ${seasonName(season.year)}`,
    ['Day', 'Probability', 'Forecast', 'Recorded', ...season.variables.map(variableName)],
    dates.map((date) => {
      const [forecast, observation] = [forecasts.get(date), season.observations.get(date)];
      return { cells: [link(date, shortDay(date)), percent(forecast?.probability), forecast ? CATEGORIES[forecast.category] : MISSING,
        ACTIVITIES[observation?.avalanche_activity] ?? 'no record',
        ...season.variables.map((name) => valueText(name, observation?.[name]))] };
    }), { class: 'dense' });
}

/** Draws the season; `choose` is called with the day that is clicked, `link` makes the link of a day. */
export function drawSeason(place, season, { selected, choose, link, trained }) {
  const wasOpen = place.querySelector('details')?.open ?? false;
  const rows = h('div');
  const details = h('details', { ontoggle: () => { if (details.open && rows.childElementCount === 0) show(rows, asTable(season, link)); } },
    h('summary', null, 'The season as a table'), rows);
  details.open = wasOpen;
  show(place,
    h('h2', null, `Season ${seasonName(season.year)}`),
    season.forecasts.length > 0 && h('p', null, summary(season)),
    season.forecasts.length > 0 && trained && h('p', { class: 'caution' },
      'Days of this season were in the training of the model. How well the bars fit shows what it remembers, not how it forecasts; the scores below come from seasons kept from it.'),
    drawn(h('div', { class: 'figure' }), (width) => draw(season, selected, choose, width)),
    legend(), details);
}
