// A forecast in words and on its scale.

import { h, s } from './dom.js';
import { ago, CATEGORIES, counted, LABELS, LEADS, longDay, percent, shortDay, variableName } from './text.js';

export const syntheticBadge = () => h('strong', { class: 'badge synthetic', title: 'Made by a generator: nothing of it was ever observed' }, 'SYNTHETIC');

export const categoryBadge = (category) => h('strong', { class: `badge ${category}` }, CATEGORIES[category] ?? category);

export function problemBox(problem) {
  return h('div', { class: 'problem', role: 'alert' },
    h('strong', null, problem.title ?? 'The page has a fault'),
    h('p', null, problem.detail ?? problem.message),
    problem.traceId && h('p', { class: 'muted' }, `request ${problem.traceId}`));
}

/** The probability on a scale from 0 to 100 % with the threshold marked. */
export function scale(forecast) {
  const x = (share) => `${(share * 100).toFixed(2)}%`;
  const label = `${percent(forecast.probability)} on a scale from 0 to 100 %, threshold ${percent(forecast.threshold)}`;
  return h('div', { class: 'scale' },
    s('svg', { role: 'img', 'aria-label': label, height: 22, width: '100%' },
      s('rect', { class: 'scale-ground', x: 0, y: 5, width: '100%', height: 12, rx: 3 }),
      s('rect', { class: `scale-value ${forecast.category}`, x: 0, y: 5, width: x(forecast.probability), height: 12, rx: 3 }),
      s('line', { class: 'scale-threshold', x1: x(forecast.threshold), x2: x(forecast.threshold), y1: 0, y2: 22 })),
    h('div', { class: 'scale-text' }, h('span', null, '0 %'),
      h('span', null, `threshold ${percent(forecast.threshold)}`), h('span', null, '100 %')));
}

/** From which day's observations the forecast was made. */
export function basis(forecast) {
  return forecast.lead === 0
    ? `${LEADS[0]} from observations up to the same day`
    : `${LEADS[forecast.lead] ?? `Lead ${forecast.lead}`}: from observations up to ${shortDay(forecast.base_date)}`;
}

/** How the end of a feature's name reads; the API has its formula. */
const ENDS = [
  [/_t$/, () => ''],
  [/_t(\d)$/, (days) => `, ${counted(days, 'day')} before`],
  [/_change(\d)$/, (days) => `, change over ${counted(days, 'day')}`],
  [/_sum(\d)$/, (days) => `, sum of ${days} days`],
  [/_mean(\d)$/, (days) => `, mean of ${days} days`],
  [/_max(\d)$/, (days) => `, largest of ${days} days`],
  [/_decayed(\d)$/, (days) => `, decayed sum of ${days} days`],
  [/_season_sum$/, () => ', sum of the season'],
];

/** The name of a feature such as `foot_penetration_t1` in words. */
function featureName(name) {
  for (const [end, text] of ENDS) {
    const found = name.match(end);
    if (found !== null) return variableName(name.slice(0, found.index)) + text(Number(found[1]));
  }
  return variableName(name);
}

function inputs(quality, formulas) {
  const list = (names) => names.map((name, at) => [at > 0 && '; ',
    h('span', { title: formulas?.get(name) ?? name, class: 'named' }, featureName(name))]);
  const line = (term, names, about) => names.length > 0
    && [h('dt', null, term), h('dd', null, list(names), h('span', { class: 'muted' }, ` (${about})`))];
  const lines = [
    line('Missing', quality.missing, 'not recorded on the newest day that is read'),
    line('Imputed', quality.imputed, 'could not be computed: the training median stands in'),
    line('Out of range', quality.out_of_range, 'never so in training: the model extrapolates'),
  ].filter(Boolean);
  return lines.length > 0
    ? h('dl', { class: 'inputs' }, lines)
    : h('p', { class: 'ok' }, 'All inputs were observed and lie in the range of the training.');
}

/** The whole forecast for the page of a station. `training` tells whether its day was in the training of the model. */
export function inWords(forecast, { now, inTraining, formulas }) {
  const against = forecast.probability >= forecast.threshold ? 'at or above' : 'below';
  return [
    h('h2', null, forecast.lead === 0 ? 'Forecast' : `Forecast, ${LEADS[forecast.lead].toLowerCase()}`),
    h('p', { class: 'when' }, h('time', { datetime: forecast.date }, longDay(forecast.date)), h('span', { class: 'muted' }, ` ${ago(forecast.date, now)}`)),
    h('p', { class: 'verdict' },
      h('span', { class: 'probability' }, percent(forecast.probability)),
      h('span', { class: 'verdict-side' }, categoryBadge(forecast.category), forecast.synthetic && syntheticBadge())),
    scale(forecast),
    h('p', null, `The probability of an avalanche day is ${percent(forecast.probability)}, ${against} the threshold of ${percent(forecast.threshold)} `,
      'from which the model counts a day as one.'),
    h('p', { class: 'muted' }, `Avalanche day: ${LABELS[forecast.label] ?? forecast.label}. ${basis(forecast)}.`),
    inputs(forecast.inputs, formulas),
    inTraining && h('p', { class: 'caution' }, 'This day was in the training of the model: what it says here is no fair test of it.'),
  ];
}
