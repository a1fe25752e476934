// The past days that the machine holds against a day: what happened then, and what each adds to the decision.

import { h, s, show, table } from './dom.js';
import { number, shortDay, signed, valueText } from './text.js';

function contribution(value, largest) {
  const half = 45;
  const length = largest > 0 ? (Math.abs(value) / largest) * half : 0;
  return h('span', { class: 'contribution' },
    s('svg', { width: half * 2, height: 12, 'aria-hidden': 'true' },
      s('rect', { class: value > 0 ? 'bar avalanche_day' : 'bar no_avalanche_day', x: value > 0 ? half : half - length, width: length, y: 1, height: 10 }),
      s('line', { class: 'axis', x1: half, x2: half, y1: 0, y2: 12 })),
    h('span', { class: 'figure-text' }, signed(value)));
}

/** The variables that are worth a column: what was the weather like on those days. */
const BESIDE = ['air_temperature', 'wind_speed', 'new_snow_24h', 'new_snow_index', 'snow_temperature'];

/** Draws the list; `observed` holds the observation of each base day, by the similar day's date. */
export function drawSimilar(place, answer, { link, observed, forecast }) {
  const days = answer.similar_days;
  const largest = Math.max(...days.map((day) => Math.abs(day.contribution)));
  const columns = BESIDE.filter((name) => [...observed.values()].some((day) => day?.[name] !== null && day?.[name] !== undefined)).slice(0, 4);
  const own = days.some((day) => day.date === answer.date);
  show(place,
    h('h2', null, 'Similar past days'),
    days.length === 0
      ? h('p', { class: 'muted' }, 'The machine holds no day that is like this one.')
      : [
        h('p', { class: 'muted' }, 'The nearest of the days that the machine holds (its support vectors). Alike: 1 is the same weather and snow. Adds: what the day adds to the decision value of ',
          `${signed(forecast.decision_value)}, above 0 speaking for an avalanche day.`,
          own && ' The day itself is among them because it was in the training.'),
        table('Similar past days, most similar first', ['Day', 'Then', 'Alike', 'Adds', ...columns.map(head)], days.map((day) => ({
          class: day.date === answer.date ? 'self' : null,
          cells: [
            link(day.date, shortDay(day.date)),
            h('span', { class: day.label ? 'then avalanche' : 'then' }, day.label ? '▲ avalanche day' : 'none'),
            number(day.kernel, 2),
            contribution(day.contribution, largest),
            ...columns.map((name) => valueText(name, observed.get(day.date)?.[name])),
          ],
        })), { class: 'dense' }),
      ]);
}

const SHORT = { air_temperature: 'Air', wind_speed: 'Wind', new_snow_24h: 'New snow', new_snow_index: 'New-snow index', snow_temperature: 'Snow' };
const head = (name) => SHORT[name];
