// The page of a station: one day and its season, and the model that speaks of them.

import { all, get, ofStation, query, repeat } from './api.js';
import { byId, h, show } from './dom.js';
import { inWords, problemBox, syntheticBadge } from './forecast.js';
import { goingOn, goingOnText, watchJobs } from './jobs.js';
import { showKey } from './key.js';
import { drawModel } from './model.js';
import { drawObservations } from './observations.js';
import { drawSeason } from './season.js';
import { drawSimilar } from './similar.js';
import { dayNumber, dayOf, LEADS, number, seasonName, seasonOf, seasonRange, today, VARIABLES } from './text.js';

const id = decodeURIComponent(location.pathname.split('/')[2]);

/** What the page knows. `day` is looked at; `year` is the season of it. */
const page = { station: null, models: [], active: new Map(), seasons: [], lead: 0, modelId: null, latest: null, season: null, day: null, training: false };

const asked = () => Object.fromEntries(new URLSearchParams(location.search));
const chosenModel = () => page.models.find((model) => model.id === (page.modelId ?? page.active.get(page.lead))) ?? null;
/** The newest day that the forecast of the day reads. */
const baseDay = (day = page.day) => dayOf(dayNumber(day) - page.lead);
const now = () => today(page.station.timezone);

const address = ({ day = page.day, lead = page.lead, modelId = page.modelId } = {}) => `/stations/${encodeURIComponent(id)}${query({
  date: day, lead: lead === 0 ? null : lead, model: modelId,
})}`;

/** A link to a day that does not load the page again. */
function link(day, text) {
  return h('a', { href: address({ day }), onclick: (event) => {
    if (event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    choose(day);
    byId('forecast').scrollIntoView({ block: 'nearest' });
  } }, h('time', { datetime: day }, text));
}

/** Shows a failure where the part should be that failed. */
async function within(place, work) {
  try {
    await work();
  } catch (problem) {
    show(byId(place), problemBox(problem));
  }
}

// What is read

async function readModels() {
  page.models = await all(`/v1/models${query({ station: id, limit: 1000 })}`, 'models');
  const leads = [...new Set(page.models.map((model) => model.lead))].sort();
  const active = await Promise.all(leads.map((lead) => get(ofStation(id, `/active-model${query({ lead })}`))));
  page.active = new Map(active.map((one) => [one.lead, one.model_id]));
}

/** The years in which a season with days begins. */
async function readSeasons() {
  const first = (await get(ofStation(id, '/observations?limit=1'))).observations[0];
  if (first === undefined) return [];
  const years = [];
  for (let year = seasonOf(first.date); year <= Math.max(seasonOf(first.date), seasonOf(now())); year += 1) years.push(year);
  const filled = await Promise.all(years.map(async (year) => {
    const [from, to] = seasonRange(year);
    return (await get(ofStation(id, `/observations${query({ from, to, limit: 1 })}`))).observations.length > 0;
  }));
  return years.filter((_, at) => filled[at]);
}

const ofModel = () => ({ lead: page.lead, model_id: page.modelId });

async function readLatest() {
  page.latest = chosenModel() === null ? null : await get(ofStation(id, `/forecasts/latest${query(ofModel())}`));
}

/** The days of a season: forecasts, observations and what they have in common. */
async function readSeason(year) {
  const [from, to] = seasonRange(year);
  const [{ forecasts }, observations] = await Promise.all([
    chosenModel() === null ? { forecasts: [] } : get(ofStation(id, `/forecasts${query({ from, to, ...ofModel() })}`)),
    all(ofStation(id, `/observations${query({ from, to })}`), 'observations'),
  ]);
  const dates = [...new Set([...forecasts, ...observations].map((day) => day.date))].sort();
  const presumed = chosenModel()?.training.label === 'presumed';
  return {
    year, forecasts, dates, first: dates[0] ?? from, last: dates.at(-1) ?? to,
    observations: new Map(observations.map((day) => [day.date, day])),
    activity: new Map(observations.filter((day) => day.avalanche_activity !== null).map((day) => [day.date, day.avalanche_activity])),
    variables: Object.keys(VARIABLES).filter((name) => observations.some((day) => day[name] !== null)),
    // whether a recorded day counts as an avalanche day under the label of the model; null where nobody can say
    event: (activity) => ({ observed: true, presumed, none: false })[activity] ?? null,
  };
}

// What is drawn

const degrees = (value, above, below) => `${number(Math.abs(value), 3)}° ${value < 0 ? below : above}`;

function drawHead() {
  const { station } = page;
  const place = [
    station.altitude_m !== null && `${number(station.altitude_m, 0)} m above sea level`,
    station.latitude !== null && station.longitude !== null && `${degrees(station.latitude, 'N', 'S')}, ${degrees(station.longitude, 'E', 'W')}`,
    station.timezone && `time zone ${station.timezone}`,
  ].filter(Boolean).join(' · ');
  document.title = `firn: ${station.name}`;
  show(byId('head'),
    h('h1', null, station.name, ' ', station.synthetic && syntheticBadge()),
    place && h('p', { class: 'muted' }, place),
    station.synthetic && h('p', { class: 'banner' }, 'Everything on this page was made by a generator: no day of it was ever observed, and no forecast is one of a real place.'));
}

/** The neighbour of the day among the days that have something, across the edge of the season too. */
function neighbour(step) {
  const { dates, year } = page.season;
  const beyond = step > 0 ? dates.find((date) => date > page.day) : dates.findLast((date) => date < page.day);
  if (beyond !== undefined) return { day: beyond };
  const other = seasonBeside(year, step);
  return other === undefined ? null : { year: other, end: step > 0 ? 'first' : 'last' };
}

/** The nearest season with days after or before a year. */
const seasonBeside = (year, step) => (step > 0
  ? page.seasons.find((other) => other > year) : page.seasons.findLast((other) => other < year));

async function go(target) {
  if (target.day !== undefined) return choose(target.day);
  const season = await readSeason(target.year);
  return choose(season[target.end], season);
}

function drawControls() {
  const step = (text, name, by) => {
    const target = neighbour(by);
    return h('button', { type: 'button', 'aria-label': name, title: name, disabled: target === null, onclick: () => within('notice', () => go(target)) }, text);
  };
  const leads = [...page.active.keys()];
  const newest = page.latest?.date ?? null;
  const seasonStep = (text, name, year) => h('button', { type: 'button', 'aria-label': name, title: name, disabled: year === undefined, onclick: () => within('notice', () => go({ year, end: 'last' })) }, text);
  const date = h('input', { type: 'date', id: 'date', value: page.day, required: true, onchange: (event) => event.target.value && choose(event.target.value) });
  const seasons = h('select', { id: 'season-choice', onchange: (event) => within('notice', () => go({ year: Number(event.target.value), end: 'last' })) },
    (page.seasons.includes(page.season.year) ? page.seasons : [...page.seasons, page.season.year].sort((a, b) => a - b)).toReversed().map((year) => h('option', { value: year, selected: year === page.season.year }, seasonName(year))));
  // a control that is pressed again and again must keep the focus although it is drawn anew
  const focused = document.activeElement?.getAttribute('aria-label') ?? document.activeElement?.id;
  show(byId('controls'), h('form', { class: 'controls', onsubmit: (event) => event.preventDefault() },
    h('span', { class: 'group' }, h('label', { for: 'date' }, 'Day'), step('‹', 'Previous day', -1), date, step('›', 'Next day', 1),
      newest !== null && h('button', { type: 'button', disabled: newest === page.day, onclick: () => choose(newest) }, 'Newest')),
    h('span', { class: 'group' }, h('label', { for: 'season-choice' }, 'Season'), seasonStep('‹', 'Previous season', seasonBeside(page.season.year, -1)), seasons, seasonStep('›', 'Next season', seasonBeside(page.season.year, 1))),
    leads.length > 1 && h('fieldset', { class: 'group' }, h('legend', null, 'Lead'), leads.map((lead) => h('label', { class: 'choice' },
      h('input', { type: 'radio', name: 'lead', value: lead, checked: lead === page.lead, onchange: () => chooseLead(lead) }), LEADS[lead] ?? lead)))));
  if (focused) byId('controls').querySelector(`[aria-label="${CSS.escape(focused)}"], #${CSS.escape(focused.replaceAll(' ', '-'))}`)?.focus();
}

function drawForecast() {
  const place = byId('forecast');
  const model = chosenModel();
  const forecast = page.season.forecasts.find((day) => day.date === page.day);
  if (model === null) {
    return show(place, h('h2', null, 'Forecast'), page.training
      ? [h('p', null, 'A model is being trained; the forecast appears here when it is done.'), h('div', { id: 'going-on' })]
      : [h('p', null, 'No model yet. Train one:'), h('pre', null, h('code', null,
        `curl -X POST ${location.origin}/v1/processes/train-model/execution -H 'Content-Type: application/json' -d '{"inputs": {"station": "${id}", "label": "observed", "lead": ${page.lead}}}'`))]);
  }
  if (forecast === undefined) {
    return show(place, h('h2', null, 'Forecast'), h('p', null, `No forecast for ${page.day}: there is no observation of ${baseDay()} that the model reads.`));
  }
  const trained = forecast.date >= model.training.first && forecast.date <= model.training.last && model.training.seasons.includes(seasonOf(forecast.date));
  return show(place, inWords(forecast, { now: now(), inTraining: trained, formulas: page.formulas }));
}

async function drawSimilarDays() {
  const place = byId('similar');
  const day = page.day;
  const forecast = page.season.forecasts.find((one) => one.date === day);
  if (chosenModel() === null || forecast === undefined) return show(place, h('h2', null, 'Similar past days'), h('p', { class: 'muted' }, 'They come with a forecast.'));
  const answer = await get(ofStation(id, `/forecasts/${day}/similar-days${query({ ...ofModel(), limit: 10 })}`));
  const observed = new Map(await Promise.all([...answer.similar_days.map((similar) => similar.date), day].map(async (date) => {
    const base = baseDay(date);
    const { observations } = await get(ofStation(id, `/observations${query({ from: base, to: base })}`));
    return [date, observations[0]];
  })));
  // whoever went on to another day meanwhile gets that day's list
  if (day === page.day) drawSimilar(place, answer, { link, observed, forecast, activity: page.season.activity.get(day) });
}

function drawDays() {
  const model = chosenModel();
  const trained = model !== null && model.training.seasons.includes(page.season.year);
  drawSeason(byId('season'), page.season, { selected: page.day, choose, link, trained });
  drawObservations(byId('observations'), page.season, { selected: baseDay(), lead: page.lead });
}

async function drawCard() {
  const model = chosenModel();
  if (model === null) return show(byId('model'));
  const evaluation = await get(`/v1/models/${model.id}/evaluation`);
  const ofAnother = (other, text) => h('a', { href: address({ lead: other.lead, modelId: other.id === page.active.get(other.lead) ? null : other.id }) }, text);
  drawModel(byId('model'), { model, evaluation, models: page.models, active: new Set(page.active.values()), link: ofAnother });
}

async function readFormulas() {
  const model = chosenModel();
  const { features } = model === null ? { features: [] } : await get(`/v1/models/${model.id}/features`);
  page.formulas = new Map(features.map((feature) => [feature.name, `${feature.name} (${feature.unit === '1' ? 'no unit' : feature.unit}): ${feature.formula}`]));
}

// What happens

/** Goes to a day, reading its season where it is another one. */
async function choose(day, season = null) {
  await within('notice', async () => {
    const year = seasonOf(day);
    page.season = season ?? (page.season?.year === year ? page.season : await readSeason(year));
    page.day = day;
    history.replaceState(null, '', address());
    show(byId('notice'));
    drawControls();
    drawForecast();
    drawDays();
    await within('similar', drawSimilarDays);
  });
}

async function chooseLead(lead) {
  page.lead = lead;
  page.modelId = null;
  page.season = null;
  await within('notice', readLatest);
  await Promise.all([within('model', drawCard), within('notice', readFormulas), choose(page.latest?.date ?? page.day)]);
}

/** Reads everything again and goes to `day`, or to the newest there is. */
async function load(day) {
  await readModels();
  if (chosenModel() === null && page.active.size > 0) [page.lead, page.modelId] = [[...page.active.keys()][0], null];
  await Promise.all([readLatest(), readFormulas(), readSeasons().then((seasons) => { page.seasons = seasons; })]);
  page.season = null;
  const last = page.seasons.at(-1);
  if (day === null && page.latest === null && last === undefined) return drawEmpty();
  const season = day === null && page.latest === null ? await readSeason(last) : null;
  await Promise.all([choose(day ?? page.latest?.date ?? season.last, season), within('model', drawCard)]);
}

function drawEmpty() {
  show(byId('controls'));
  show(byId('similar'));
  show(byId('forecast'), h('h2', null, 'No observations yet'), h('p', null, 'Send the days of the station first:'),
    h('pre', null, h('code', null, `curl -X POST ${location.origin}${ofStation(id, '/observations')} -H 'Content-Type: text/csv' --data-binary @observations.csv`)));
}

/** While there is no model, its training is what there is to see; afterwards a new model or a new day is. */
async function follow({ going }, ended) {
  const trains = going.filter((job) => job.processID === 'train-model');
  const changed = page.training !== trains.length > 0;
  page.training = trains.length > 0;
  if (ended) await load(chosenModel() === null ? null : page.day);
  else if (changed && page.season !== null) drawForecast();
  const place = byId('going-on');
  if (place !== null) show(place, goingOn(trains));
  else if (!ended) show(byId('notice'), trains.length > 0 && chosenModel() !== null && h('p', { class: 'muted' }, `${goingOnText(trains)} (training)`));
}

/** Whoever left the page open over night finds the new day in the morning. */
async function refresh() {
  const before = page.latest;
  if (before === null) return;
  await readLatest();
  if (page.latest.date !== before.date || page.latest.probability !== before.probability || page.latest.model_id !== before.model_id) {
    await load(page.day === before.date ? null : page.day);
  }
}

async function start() {
  showKey();
  get('/livez').then((health) => show(byId('version'), `firn ${health.version}`), () => {});
  const { date = null, lead, model = null } = asked();
  page.lead = lead === '1' ? 1 : 0;
  page.modelId = model;
  try {
    page.station = await get(ofStation(id));
    drawHead();
    await load(/^\d{4}-\d{2}-\d{2}$/.test(date ?? '') ? date : null);
  } catch (problem) {
    ['forecast', 'similar', 'season', 'observations'].forEach((part) => byId(part).classList.add('gone'));
    return show(byId('notice'), problemBox(problem));
  }
  const failed = (problem) => show(byId('notice'), problemBox(problem));
  await watchJobs(follow, failed);
  return setTimeout(() => repeat(() => refresh().catch(failed), () => 60), 60_000);
}

start();
