use super::*;
use crate::emission::close;
use crate::emission::synthetic::{SyntheticOptions, synthetic};
use crate::progress::Unobserved;

fn uniform(n: usize, seed: u64) -> Vec<[f64; 3]> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| [0; 3].map(|_| rng.random())).collect()
}

#[test]
fn pairs_are_counted_exactly() {
    let points = uniform(700, 1);
    // radii that are distances themselves, so that "at most" is tested
    let distance = |a: [f64; 3], b: [f64; 3]| {
        let d = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
        d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    };
    let mut radii = log_spaced(1e-3, 1.8, 40);
    let unit = vec![[0.0; 3], [0.5, 0.0, 0.0], [0.0, 0.5, 0.5]];
    radii.push(2.0);
    let counts = PairCounter::new(&radii).count(&points, &Unobserved, "").unwrap();
    for (r, count) in radii.iter().zip(&counts) {
        let brute = (0..700).flat_map(|i| (0..i).map(move |j| (i, j)));
        let brute = brute.filter(|&(i, j)| distance(points[i], points[j]) <= r * r).count();
        assert_eq!(*count, brute as u64, "{r}");
    }
    assert_eq!(PairCounter::new(&[0.4, 0.5, 0.6]).count(&unit, &Unobserved, "").unwrap(), [0, 1, 1]);
}

fn dimension(points: &[[f64; 3]], error: f64) -> CorrelationIntegral {
    correlation_integral(points, Some(error), None, &CorrelationOptions::default(), 1, &Unobserved).unwrap()
}

#[test]
fn clouds_of_known_dimension_come_out_within_a_tenth() {
    for truth in [2.5, 2.0, 3.0] {
        let options = SyntheticOptions { events: 5000, dimension: truth, location_error_m: 1e-5, ..Default::default() };
        let positions = synthetic(&options, 1).unwrap().0.positions("x").unwrap().0;
        let found = dimension(&positions, 1e-5);
        close(found.dimension, truth, 0.1);
        assert_eq!(found.embedding, 3);
    }
    // a plane is uniform in its two dimensions
    let plane: Vec<[f64; 3]> = uniform(3000, 2).into_iter().map(|[x, y, _]| [x, y, 0.5]).collect();
    let found = dimension(&plane, 0.0);
    assert_eq!(found.embedding, 2);
    close(found.dimension, 2.0, 0.1);
    // Takens' estimate knows no null: of a straight line it is 1 up to its two ends
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let rod: Vec<[f64; 3]> = (0..3000).map(|_| [rng.random(), 0.0, 0.0]).collect();
    let options = CorrelationOptions { r_max_m: Some(0.02), ..Default::default() };
    let found = correlation_integral(&rod, None, None, &options, 1, &Unobserved).unwrap();
    close(found.takens, 1.0, 0.03);
}

#[test]
fn the_location_error_sets_the_smallest_radius_and_grains_the_unit() {
    let points = uniform(500, 1);
    let options = CorrelationOptions::default();
    let found = correlation_integral(&points, Some(0.01), Some(0.05), &options, 1, &Unobserved).unwrap();
    close(found.points[0].r_m, 0.02, 1e-12);
    close(found.points[0].r_grains.unwrap(), 0.4, 1e-12);
    assert!(found.points.windows(2).all(|pair| pair[0].pairs <= pair[1].pairs));
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let points = uniform(1500, 1);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| dimension(&points, 0.001))
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(8));
}

#[test]
fn nonsense_is_refused_by_name() {
    let points = uniform(100, 1);
    let run = |points: &[[f64; 3]], options| {
        correlation_integral(points, None, None, &options, 1, &Unobserved).unwrap_err().to_string()
    };
    let base = CorrelationOptions::default();
    assert!(run(&points[..20], base).starts_with("correlation_integral: 20 event(s)"));
    assert!(run(&[[1.0; 3]; 60], base).starts_with("the positions: all values are equal"));
    assert!(run(&points, CorrelationOptions { radii: 1, ..base }).starts_with("radii is 1"));
    assert!(run(&points, CorrelationOptions { r_max_m: Some(1e-9), ..base }).starts_with("r_max_m is"));
}
