// The first page: every station with its newest forecasts, and the jobs that go on.

import { all, get, ofStation, query, repeat } from './api.js';
import { byId, h, s, show } from './dom.js';
import { basis, categoryBadge, problemBox, scale, syntheticBadge } from './forecast.js';
import { drawJobs, watchJobs } from './jobs.js';
import { showKey } from './key.js';
import { ago, dayNumber, dayOf, LABELS, LEADS, longDay, percent, today } from './text.js';

/** Days of the strip of bars beside a forecast. */
const STRIP_DAYS = 30;

const href = (station, more = {}) => `/stations/${encodeURIComponent(station.id)}${query(more)}`;

/** The newest forecast of each lead that the station has a model of, and the days before it. */
async function readStation(station) {
  const models = await all(`/v1/models${query({ station: station.id, limit: 1000 })}`, 'models');
  const leads = [...new Set(models.map((model) => model.lead))].sort();
  const forecasts = await Promise.all(leads.map(async (lead) => {
    const latest = await get(ofStation(station.id, `/forecasts/latest${query({ lead })}`));
    const from = dayOf(dayNumber(latest.date) - STRIP_DAYS + 1);
    const { forecasts: strip } = await get(ofStation(station.id, `/forecasts${query({ lead, from, to: latest.date })}`));
    return { latest, strip };
  }));
  return { station, forecasts };
}

function strip({ latest, strip: days }) {
  const last = dayNumber(latest.date);
  const bars = days.map((day) => s('rect', {
    class: `bar ${day.category}`, x: (STRIP_DAYS - 1 - (last - dayNumber(day.date))) * 6, width: 4.6,
    y: 36 - Math.max(1, day.probability * 36), height: Math.max(1, day.probability * 36),
  }, s('title', null, `${day.date}: ${percent(day.probability)}`)));
  const y = 36 - latest.threshold * 36;
  return h('figure', { class: 'strip' },
    s('svg', { viewBox: `0 0 ${STRIP_DAYS * 6} 37`, role: 'img', preserveAspectRatio: 'none',
      'aria-label': `Probabilities of the last ${STRIP_DAYS} days up to ${latest.date}, with the threshold` },
      bars, s('line', { class: 'threshold', x1: 0, x2: STRIP_DAYS * 6, y1: y, y2: y, 'vector-effect': 'non-scaling-stroke' })),
    h('figcaption', { class: 'muted' }, `last ${STRIP_DAYS} days, dashed: threshold`));
}

function newest(station, forecast) {
  const { latest } = forecast;
  return h('div', { class: 'newest' },
    h('p', { class: 'when' }, h('span', { class: 'badge' }, LEADS[latest.lead] ?? `Lead ${latest.lead}`), ' ', h('time', { datetime: latest.date }, longDay(latest.date)),
      h('span', { class: 'muted' }, ` ${ago(latest.date, today(station.timezone))}`)),
    h('div', { class: 'newest-row' },
      h('p', { class: 'verdict' }, h('a', { class: 'probability', href: href(station, { lead: latest.lead, date: latest.date }) }, percent(latest.probability)),
        h('span', { class: 'verdict-side' }, categoryBadge(latest.category), latest.synthetic && syntheticBadge())),
      h('div', { class: 'newest-scale' }, scale(latest)),
      strip(forecast)),
    h('p', { class: 'muted' }, `Avalanche day: ${LABELS[latest.label] ?? latest.label} (label ${latest.label}). ${basis(latest)}.`));
}

function stationCard({ station, forecasts, problem, training }) {
  const place = [station.altitude_m !== null && `${station.altitude_m} m`, station.timezone].filter(Boolean).join(', ');
  return h('li', { class: 'card' },
    h('div', { class: 'card-head' },
      h('h3', null, h('a', { href: href(station) }, station.name)),
      station.synthetic && syntheticBadge(), h('span', { class: 'muted' }, place)),
    problem && problemBox(problem),
    forecasts?.map((forecast) => newest(station, forecast)),
    forecasts?.length === 0 && h('p', { class: 'muted' }, training
      ? 'No model yet: a training job is going on, see below.'
      : 'No model yet: train one with the process train-model, see below.'));
}

let jobs = { going: [], last: [] };

async function drawStations() {
  const place = byId('stations');
  try {
    const stations = await all('/v1/stations?limit=1000', 'stations');
    const read = await Promise.all(stations.map((station) => readStation(station).catch((problem) => ({ station, problem }))));
    const training = jobs.going.some((job) => job.processID === 'train-model');
    byId('begin').open ||= stations.length === 0;
    show(place, stations.length === 0
      ? h('div', { class: 'card' }, h('p', null, 'There is no station yet. Begin with the four lines below, or look at made-up data with ', h('code', null, 'firn serve --demo'), '.'))
      : h('ul', { class: 'stations' }, read.map((one) => stationCard({ ...one, training }))));
    show(byId('notice'));
  } catch (problem) {
    show(place, problemBox(problem));
  }
}

/** Lines that work when pasted, for a station that does not exist yet. */
function beginning() {
  const at = location.origin;
  const key = sessionStorage.getItem('firn-key') === null ? '' : ' -H "Authorization: Bearer $FIRN_KEY"';
  const json = "-H 'Content-Type: application/json'";
  const step = (about, line) => [h('p', null, about), h('pre', null, h('code', null, line))];
  return [
    step('1. Make the station.', `curl -X PUT ${at}/v1/stations/my-station${key} ${json} -d '{"name": "My station", "timezone": "Europe/London"}'`),
    step('2. Send its days: the CSV of the API, NDJSON, JSON, or with ?format=sais the export of the Scottish service. A model needs at least three seasons with avalanche days and days without.',
      `curl -X POST ${at}/v1/stations/my-station/observations${key} -H 'Content-Type: text/csv' --data-binary @observations.csv`),
    step('3. Train a model; the first one of a station becomes its active one.',
      `curl -X POST ${at}/v1/processes/train-model/execution${key} ${json} -d '{"inputs": {"station": "my-station", "label": "observed", "lead": 0}}'`),
    step('4. Read the newest forecast.', `curl ${at}/v1/stations/my-station/forecasts/latest${key}`),
  ];
}

async function start() {
  showKey();
  show(byId('begin-lines'), beginning());
  get('/livez').then((health) => show(byId('version'), `firn ${health.version}`), () => {});
  await watchJobs(async (now, ended) => {
    jobs = now;
    drawJobs(byId('jobs'), jobs.going, jobs.last);
    if (ended) await drawStations();
  }, (problem) => show(byId('jobs'), problemBox(problem)));
  await repeat(drawStations, () => 60);
}

start();
