// What every chart of days shares: a scale of days, months below, and days of avalanches.

import { s } from './dom.js';
import { ACTIVITIES, dayMonth, dayNumber, dayOf, month } from './text.js';

/** Room beside the days: for the values on the left, and a little on the right. */
export const MARGIN = { left: 40, right: 10 };

/** The days of a season on the width of a chart: `x` is the middle of a day, `step` its width. */
export function dayScale(first, last, width, right = MARGIN.right) {
  const from = dayNumber(first);
  const days = Math.max(1, dayNumber(last) - from + 1);
  const step = (width - MARGIN.left - right) / days;
  return {
    from, days, step, first, last,
    x: (date) => MARGIN.left + (dayNumber(date) - from + 0.5) * step,
    dateAt: (x) => dayOf(from + Math.min(days - 1, Math.max(0, Math.floor((x - MARGIN.left) / step)))),
  };
}

/** Lines and names of the months from `top` to `bottom`. */
export function months(scale, top, bottom) {
  const marks = [];
  for (let day = scale.from; day < scale.from + scale.days; day += 1) {
    const date = dayOf(day);
    if (!date.endsWith('-01')) continue;
    const x = scale.x(date) - scale.step / 2;
    const name = scale.step * 25 > 30 ? month(date) : month(date).slice(0, 1);
    marks.push(s('line', { class: 'grid', x1: x, x2: x, y1: top, y2: bottom }),
      s('text', { class: 'tick', x: x + 3, y: bottom + 12 }, name));
  }
  // the first day is named where the name of the next month leaves room for it
  const rest = 32 - Number(scale.first.slice(8));
  if (!scale.first.endsWith('-01') && rest * scale.step > 58) marks.push(s('text', { class: 'tick', x: MARGIN.left, y: bottom + 12 }, dayMonth(scale.first)));
  return marks;
}

/** A mark of what is recorded of the avalanches of a day: full where seen, hollow where judged likely. */
export function activityMark(activity, x, y, size = 4.2) {
  const triangle = `M${x - size} ${y + size * 0.8}L${x} ${y - size}L${x + size} ${y + size * 0.8}Z`;
  if (activity === 'observed') return s('path', { class: 'mark-observed', d: triangle }, s('title', null, ACTIVITIES.observed));
  if (activity === 'presumed') return s('path', { class: 'mark-presumed', d: triangle }, s('title', null, ACTIVITIES.presumed));
  if (activity === 'unknown') return s('text', { class: 'mark-unknown', x, y: y + 3, 'text-anchor': 'middle' }, '?');
  return null;
}

/** The line of the day that is looked at. */
export const cursor = (scale, date, top, bottom) => date >= scale.first && date <= scale.last
  && s('line', { class: 'cursor', x1: scale.x(date), x2: scale.x(date), y1: top, y2: bottom });

/** Runs of neighbouring days: a line that crosses a missing day would invent it. */
export function runs(points) {
  const result = [];
  let last = null;
  for (const point of points) {
    if (last === null || dayNumber(point.date) - last !== 1) result.push([]);
    result.at(-1).push(point);
    last = dayNumber(point.date);
  }
  return result;
}

/** The axis text of a value. */
export const tick = (text, y) => s('text', { class: 'tick', x: MARGIN.left - 5, y: y + 4, 'text-anchor': 'end' }, text);
