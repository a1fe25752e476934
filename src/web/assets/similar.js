// The past days that the machine holds against a day: what happened then, and what each adds to the decision.

import { h, s, show, table } from './dom.js';
import { ACTIVITIES, MISSING, number, plainDay, signed, valueText, VARIABLES } from './text.js';

const HALF = 36;

/** What follows from the calendar or sums the whole season says little of a single day. */
const LEFT_OUT = ['cumulative_snow_index', 'insolation_index'];

/** A bar to the right where the day speaks for an avalanche day, to the left where against. */
function contribution(value, largest) {
  const length = largest > 0 ? (Math.abs(value) / largest) * HALF : 0;
  return h('span', { class: 'contribution' },
    s('svg', { width: HALF * 2, height: 12, 'aria-hidden': 'true' },
      s('rect', { class: value > 0 ? 'bar avalanche_day' : 'bar no_avalanche_day', x: value > 0 ? HALF : HALF - length, width: length, y: 1, height: 10 }),
      s('line', { class: 'axis', x1: HALF, x2: HALF, y1: 0, y2: 12 })),
    h('span', { class: 'figure-text' }, signed(value)));
}

const numbers = (values) => values.map((value) => ({ value, class: 'number' }));

/** Draws the list; `observed` holds the observation of the base day of each day, of the day that is forecast too. */
export function drawSimilar(place, answer, { link, observed, forecast, activity }) {
  const days = answer.similar_days;
  const largest = Math.max(...days.map((day) => Math.abs(day.contribution)));
  const columns = Object.keys(VARIABLES).filter((name) => !LEFT_OUT.includes(name) && [...observed.values()].some((day) => (day?.[name] ?? null) !== null));
  const weather = (date) => numbers(columns.map((name) => valueText(name, observed.get(date)?.[name])));
  const held = days.some((day) => day.date === answer.date);
  const own = { class: 'self', cells: [h('span', null, plainDay(answer.date)), h('span', { class: 'then' }, ACTIVITIES[activity] ?? 'no record yet'), h('span', { class: 'then' }, 'this day'), ...numbers([MISSING]), ...weather(answer.date)] };
  show(place,
    h('h2', null, 'Similar past days'),
    days.length === 0
      ? h('p', { class: 'muted' }, 'The machine holds no day that is like this one.')
      : [
        h('p', { class: 'muted wide' }, 'The nearest of the days that the machine holds (its support vectors) and what happened. Adds: what the day adds to the decision value, which is ',
          `${signed(forecast.decision_value)} with all days held and the offset of the machine; above 0 speaks for an avalanche day. Alike: 1 is the same weather and snow.`,
          held && ' The day itself is among them because it was in the training.'),
        table('Similar past days, most similar first', ['Day', 'What happened', 'Adds', ...numbers(['Alike', ...columns.map((name) => VARIABLES[name].name)])], [
          ...(held ? [] : [own]),
          ...days.map((day) => ({
            class: day.date === answer.date ? 'self' : null,
            cells: [
              link(day.date, plainDay(day.date)),
              h('span', { class: day.label ? 'then avalanche' : 'then' }, day.label ? '▲ avalanche day' : 'no avalanche day'),
              contribution(day.contribution, largest),
              ...numbers([number(day.kernel, 2)]),
              ...weather(day.date),
            ],
          })),
        ], { class: 'dense' }),
      ]);
}
