// The model card: what the model is, and what it is worth beside simpler methods on seasons that it has not seen.

import { drawn, h, s, show, table } from './dom.js';
import { syntheticBadge } from './forecast.js';
import { count, counted, instant, LABELS, LEADS, MISSING, MODELS, number, percent, seasonName, shortDay, signed } from './text.js';

const KINDS = Object.keys(MODELS);

const RULES = {
  peirce: () => 'chosen for the best Peirce skill in the training folds',
  cost_loss: (rule) => `the cost/loss ratio that was asked for, ${number(rule.ratio, 2)}`,
};

function about(model) {
  const { training } = model;
  const kernel = training.kernel === 'gaussian'
    ? `Gaussian kernel (γ = ${training.gamma}, C = ${training.c})` : `linear kernel (C = ${training.c})`;
  const facts = [
    ['Machine', `Support vector machine, ${kernel}; ${count(training.support_vectors)} support vectors`],
    ['Inputs', `${training.features} features of the set ${training.feature_set}, version ${training.feature_set_version}`],
    ['Training', `${shortDay(training.first)} to ${shortDay(training.last)}: ${counted(training.days, 'day')}, ${counted(training.events, 'avalanche day')} (${percent(training.base_rate)}), ${counted(training.seasons.length, 'season')}`],
    ['Label', `${training.label}: ${LABELS[training.label] ?? training.label}`],
    ['Threshold', `${percent(training.threshold)}, ${RULES[training.threshold_rule?.kind]?.(training.threshold_rule) ?? 'see the model document'}`],
    ['Made', `${instant(model.created)}, firn ${model.provenance?.version ?? MISSING}, seed ${model.provenance?.seed ?? MISSING}`],
    ['Documents', [h('a', { href: `/v1/models/${model.id}` }, 'model'), ', ', h('a', { href: `/v1/models/${model.id}/evaluation` }, 'evaluation'), ', ', h('a', { href: `/v1/models/${model.id}/features` }, 'features')]],
  ];
  return h('dl', { class: 'facts' }, facts.map(([term, text]) => [h('dt', null, term), h('dd', null, text)]));
}

const COLUMNS = [
  ['AUC', 'auc', 'area under the ROC curve: 0.5 no skill, 1 perfect'], ['BSS', 'brier_skill', 'Brier skill against climatology: 0 as good as it, 1 perfect'],
  ['PSS', 'pss', 'Peirce skill: hits among avalanche days minus false alarms among the others'],
  ['POD', 'pod', 'hits among avalanche days'], ['FAR', 'far', 'false alarms among warnings: small is good'],
];

function scores(caption, perModel, intervals) {
  const heads = ['Method', ...COLUMNS.map(([name, , text]) => ({ value: h('abbr', { title: text }, name), class: 'number' }))];
  const cell = (kind, field) => {
    const interval = intervals?.models[kind]?.[field];
    const spread = interval && !(field === 'brier_skill' && kind === 'climatology') && field in intervals.models[kind]
      ? h('span', { class: 'interval' }, `${number(interval.lower, 2)} … ${number(interval.upper, 2)}`) : null;
    return { class: 'number', value: [h('span', null, number(perModel[kind][field], field === 'auc' ? 3 : 2)), spread] };
  };
  return table(caption, heads, KINDS.map((kind) => ({
    class: kind === 'svm' ? 'self' : null, cells: [MODELS[kind], ...COLUMNS.map(([, field]) => cell(kind, field))],
  })), { class: 'scores' });
}

/** What the comparison comes to, in a sentence that does not flatter. */
function verdict(evaluation) {
  const difference = evaluation.bootstrap.svm_minus_knn30_auc;
  const level = Math.round(evaluation.bootstrap.level * 100);
  const ranked = KINDS.filter((kind) => evaluation.scores[kind].auc !== null).sort((a, b) => evaluation.scores[b].auc - evaluation.scores[a].auc);
  const best = ranked.length > 0 && ranked[0] !== 'svm'
    ? ` The largest AUC here is that of ${MODELS[ranked[0]].toLowerCase()}, ${number(evaluation.scores[ranked[0]].auc, 3)}.` : '';
  if (difference === null) return `Whether the SVM differs from nearest neighbours cannot be told from these seasons.${best}`;
  const text = `The AUC of the SVM minus that of nearest neighbours (k = 30) is ${signed(difference.estimate, 3)}, `
    + `${level}\u202f% interval ${signed(difference.lower, 3)} … ${signed(difference.upper, 3)} over seasons`;
  if (difference.lower <= 0 && difference.upper >= 0) return [h('strong', null, 'No real difference. '), `${text}, which contains 0: on these seasons nearest neighbours do as well.${best}`];
  return [h('strong', null, difference.estimate > 0 ? 'The SVM is better than nearest neighbours. ' : 'Nearest neighbours are better than the SVM. '), `${text}, which does not contain 0.${best}`];
}

function reliabilityChart(evaluation, width) {
  const size = Math.min(width, 380);
  const [left, right, top] = [44, 22, 10];
  const plot = size - left - right;
  const counts = 50;
  const bottom = top + plot;
  const height = bottom + 30 + counts + 18;
  const x = (share) => left + share * plot;
  const y = (share) => bottom - share * plot;
  const most = Math.max(1, ...evaluation.reliability.map((bin) => bin.count));
  const filled = evaluation.reliability.filter((bin) => bin.count > 0);
  const base = height - 16;
  return s('svg', { width: left + plot + right, height, class: 'chart', role: 'img', 'aria-label': 'Reliability diagram: observed frequency against forecast probability, with the number of days of each bin; the values stand in the table below' },
    [0, 0.25, 0.5, 0.75, 1].map((share) => [
      s('line', { class: 'grid', x1: x(0), x2: x(1), y1: y(share), y2: y(share) }), s('line', { class: 'grid', x1: x(share), x2: x(share), y1: y(0), y2: y(1) }),
      s('text', { class: 'tick', x: left - 5, y: y(share) + 4, 'text-anchor': 'end' }, `${share * 100} %`),
      s('text', { class: 'tick', x: x(share), y: bottom + 15, 'text-anchor': share === 0 ? 'start' : 'middle' }, `${share * 100} %`)]),
    s('line', { class: 'ideal', x1: x(0), y1: y(0), x2: x(1), y2: y(1) }),
    s('line', { class: 'threshold', x1: x(0), x2: x(1), y1: y(evaluation.base_rate), y2: y(evaluation.base_rate) }),
    s('text', { class: 'threshold-text', x: x(1) - 2, y: y(evaluation.base_rate) - 4, 'text-anchor': 'end' }, `base rate ${percent(evaluation.base_rate)}`),
    s('path', { class: 'line', d: `M${filled.map((bin) => `${x(bin.mean_probability)} ${y(bin.observed_frequency)}`).join('L')}` }),
    filled.map((bin) => s('circle', { class: 'point', cx: x(bin.mean_probability), cy: y(bin.observed_frequency), r: 4 }, s('title', null, `${percent(bin.mean_probability)} forecast, ${percent(bin.observed_frequency)} observed on ${counted(bin.count, 'day')}`))),
    evaluation.reliability.map((bin) => {
      const tall = (bin.count / most) * (counts - 14);
      const [from, to] = [x(bin.lower) + 1, x(bin.upper) - 1];
      return [s('rect', { class: 'amount', x: from, width: to - from, y: base - tall, height: tall }),
        s('text', { class: 'tick', x: (from + to) / 2, y: base - tall - 3, 'text-anchor': 'middle' }, String(bin.count))];
    }),
    s('line', { class: 'grid', x1: x(0), x2: x(1), y1: base, y2: base }),
    s('text', { class: 'tick', x: x(0.5), y: height - 3, 'text-anchor': 'middle' }, 'days in each bin of forecast probability'));
}

function reliability(evaluation) {
  return h('section', { class: 'card' },
    h('h3', null, 'Reliability'),
    h('p', { class: 'muted' }, 'Across: forecast probability. Up: how often it was an avalanche day. On the diagonal the forecast keeps its word.'),
    drawn(h('div', { class: 'figure' }), (width) => reliabilityChart(evaluation, width)),
    h('details', null, h('summary', null, 'As a table'), table('Reliability of the SVM, every season left out once',
      ['Forecast', { value: 'Mean', class: 'number' }, { value: 'Observed', class: 'number' }, { value: 'Days', class: 'number' }],
      evaluation.reliability.map((bin) => ({
        cells: [`${Math.round(bin.lower * 100)} to ${Math.round(bin.upper * 100)} %`, ...[percent(bin.mean_probability), percent(bin.observed_frequency), count(bin.count)].map((value) => ({ value, class: 'number' }))],
      })))));
}

function seasonsChart(evaluation, width) {
  const [left, right, top, bottom, height] = [40, 10, 12, 196, 216];
  const seasons = evaluation.per_season;
  const drawnKinds = [['knn30', 'point-hollow'], ['svm', 'point']];
  const values = seasons.flatMap((season) => drawnKinds.map(([kind]) => season.scores[kind].auc)).filter((auc) => auc !== null);
  const low = Math.min(0.5, Math.floor(Math.min(...values) * 10) / 10);
  const y = (auc) => bottom - ((auc - low) / (1 - low)) * (bottom - top);
  const x = (at) => left + ((at + 0.5) / seasons.length) * (width - left - right);
  const room = (width - left - right) / seasons.length;
  const steps = [];
  for (let tenth = Math.round(low * 10); tenth <= 10; tenth += 1) steps.push(tenth / 10);
  return s('svg', { width, height, class: 'chart', role: 'img', 'aria-label': `AUC of each season that was left out, ${seasonName(seasons[0].season)} to ${seasonName(seasons.at(-1).season)}; the values stand in the table below` },
    steps.map((auc) => [s('line', { class: auc === 0.5 ? 'zero' : 'grid', x1: left, x2: width - right, y1: y(auc), y2: y(auc) }), s('text', { class: 'tick', x: left - 5, y: y(auc) + 4, 'text-anchor': 'end' }, number(auc, 1))]),
    seasons.map((season, at) => [
      (room > 44 || at % 2 === 0) && s('text', { class: 'tick', x: x(at), y: bottom + 15, 'text-anchor': 'middle' }, `${String(season.season % 100).padStart(2, '0')}/${String((season.season + 1) % 100).padStart(2, '0')}`),
      drawnKinds.map(([kind, name]) => season.scores[kind].auc !== null && s('circle', { class: name, cx: x(at), cy: y(season.scores[kind].auc), r: 4.5 },
        s('title', null, `${seasonName(season.season)}, ${MODELS[kind]}: ${number(season.scores[kind].auc, 3)}`)))]));
}

function seasons(evaluation) {
  const known = evaluation.per_season.some((season) => season.scores.svm.auc !== null);
  return h('section', { class: 'card' },
    h('h3', null, 'Season by season'),
    h('p', { class: 'muted' }, 'AUC of each season, forecast by models of the other seasons; 0.5 is no skill.'),
    known && drawn(h('div', { class: 'figure' }), (width) => seasonsChart(evaluation, width)),
    h('ul', { class: 'legend' }, [['point', 'SVM'], ['point-hollow', 'nearest neighbours, k = 30']].map(([name, text]) => h('li', null, s('svg', { width: 12, height: 12, 'aria-hidden': 'true' }, s('circle', { class: name, cx: 6, cy: 6, r: 4.5 })), text))),
    h('details', null, h('summary', null, 'As a table'), table('AUC of each season left out',
      ['Season', { value: 'Days', class: 'number' }, { value: 'Avalanche days', class: 'number' }, ...KINDS.map((kind) => ({ value: MODELS[kind], class: 'number' }))],
      evaluation.per_season.map((season) => ({
        cells: [seasonName(season.season), ...[count(season.days), count(season.events), ...KINDS.map((kind) => number(season.scores[kind].auc, 3))].map((value) => ({ value, class: 'number' }))],
      })), { class: 'dense' })));
}

function chaining(forward) {
  if (forward === null) return h('p', { class: 'muted' }, 'Forward chaining needs more seasons than there are.');
  return [
    h('p', { class: 'muted' }, `Forward chaining: each of the seasons ${seasonName(forward.seasons[0])} to ${seasonName(forward.seasons.at(-1))} is forecast from the seasons before it only, as it would have been. `
      + `${counted(forward.days, 'day')}, ${counted(forward.events, 'avalanche day')}. This is the number to trust.`),
    scores('Scores of forward chaining', forward.scores, null),
  ];
}

function others(models, active, link) {
  if (models.length < 2) return null;
  return h('section', { class: 'card' }, h('h3', null, 'Models of this station'), table('Models of this station, newest first',
    ['Made', 'Lead', 'Label', { value: 'AUC', class: 'number' }, { value: 'PSS', class: 'number' }, ''],
    models.map((model) => ({
      cells: [link(model, instant(model.created)), LEADS[model.lead] ?? model.lead, model.training.label, { value: number(model.scores.auc, 3), class: 'number' }, { value: number(model.scores.pss, 2), class: 'number' },
        active.has(model.id) ? 'active' : ''],
    }))));
}

/** Draws the card of `model` with its `evaluation`. */
export function drawModel(place, { model, evaluation, models, active, link }) {
  show(place,
    h('section', { class: 'card' },
      h('div', { class: 'card-head' }, h('h2', null, 'The model'), model.synthetic && syntheticBadge(), active.has(model.id) ? h('span', { class: 'badge' }, 'active') : h('span', { class: 'badge' }, 'not active')),
      about(model)),
    h('div', { class: 'pair even' },
      h('section', { class: 'card' },
        h('h3', null, 'Scores beside simpler methods'),
        h('p', { class: 'verdict-text' }, verdict(evaluation)),
        h('p', { class: 'muted' }, `Every season left out once: ${counted(evaluation.days, 'day')}, ${counted(evaluation.events, 'avalanche day')} in ${counted(evaluation.seasons, 'season')}. In small print: ${percent(evaluation.bootstrap.level)} intervals over seasons.`),
        scores('Scores, every season left out once', evaluation.scores, evaluation.bootstrap),
        chaining(evaluation.forward_chaining)),
      h('div', { class: 'stack' }, reliability(evaluation), seasons(evaluation))),
    others(models, active, link));
}
