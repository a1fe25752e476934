// Jobs as they go: polled, because a poll passes every proxy.

import { get, repeat } from './api.js';
import { h, show, table } from './dom.js';
import { counted, instant, MISSING } from './text.js';

const PROCESSES = { 'train-model': 'Train a model' };
const STATES = { accepted: 'waiting', running: 'running', successful: 'done', failed: 'failed', dismissed: 'given up' };

/** A list of the jobs that go on, with bars that fill. */
export function goingOn(jobs) {
  return h('ul', { class: 'jobs' }, jobs.map((job) => {
    const name = PROCESSES[job.processID] ?? job.processID;
    return h('li', null,
      h('div', { class: 'job-line' },
        h('strong', null, name), h('span', null, `${STATES[job.status]}, ${job.progress} %`)),
      h('progress', { max: 100, value: job.progress, 'aria-label': `${name}: ${job.progress} %` }),
      h('p', { class: 'muted' }, job.phase ?? job.message ?? 'waits for a free slot'));
  }));
}

function seconds(job) {
  if (job.started === null || job.finished === null) return MISSING;
  const spent = Math.max(0, (Date.parse(job.finished) - Date.parse(job.started)) / 1000);
  return spent < 120 ? `${Math.round(spent)} s` : `${Math.round(spent / 60)} min`;
}

const ended = (jobs) => table('Jobs that ended last', ['Job', 'State', 'Took', 'Ended', 'What it said'], jobs.map((job) => ({
  cells: [
    h('a', { href: `/v1/jobs/${job.jobID}` }, PROCESSES[job.processID] ?? job.processID),
    h('span', { class: `state ${job.status}` }, STATES[job.status]),
    seconds(job),
    h('time', { datetime: job.finished ?? job.updated }, instant(job.finished ?? job.updated)),
    job.exception?.detail ?? job.message ?? MISSING,
  ],
})));

/** What the home page shows of jobs. */
export function drawJobs(place, going, last) {
  show(place,
    going.length > 0 && h('div', { class: 'card' }, goingOn(going)),
    last.length > 0 && ended(last),
    going.length + last.length === 0 && h('p', { class: 'muted' }, 'No job was ever started.'));
}

/** The jobs that go on and those that ended last. */
export async function readJobs() {
  const [going, recent] = await Promise.all([get('/v1/jobs?status=accepted,running&limit=50'), get('/v1/jobs?status=successful,failed,dismissed&limit=5')]);
  return { going: going.jobs, last: recent.jobs };
}

/**
 * Watches the jobs: `changed(jobs, ended)` after each look, `ended` true where one that went on does no more. Looks each second
 * while something goes on, else every `idle` seconds.
 */
export function watchJobs(changed, failed, idle = 10) {
  let going = new Set();
  return repeat(async () => {
    try {
      const jobs = await readJobs();
      const now = new Set(jobs.going.map((job) => job.jobID));
      const ended = [...going].some((id) => !now.has(id));
      going = now;
      await changed(jobs, ended);
    } catch (problem) {
      failed(problem);
    }
  }, () => (going.size > 0 ? 1 : idle));
}

/** How many go on, for those who cannot see the bars. */
export const goingOnText = (jobs) => (jobs.length === 0 ? '' : `${counted(jobs.length, 'job')} going on`);
