use std::sync::Mutex;

use super::*;
use crate::forecast::problems::eight_waves;
use crate::forecast::svm::machine::train;
use crate::forecast::svm::problems::seasons;
use crate::progress::Unobserved;

const EXACT: SolverOptions = SolverOptions { epsilon: 1e-8, max_iterations: 10_000_000, memory_limit_bytes: 1 << 30 };

fn columns_of(x: &Matrix, columns: &[usize]) -> Matrix {
    let data = (0..x.rows()).flat_map(|i| columns.iter().map(move |&j| x.row(i)[j])).collect();
    Matrix::from_rows(x.rows(), columns.len(), data).unwrap()
}

/// Everything from the definition at every step: a fit from nothing, all pairs, the platform's `exp`.
fn plain(x: &Matrix, labels: &[bool], held_out: &Matrix, recipe: &EliminationRecipe) -> Elimination {
    let kernel = Kernel::Gaussian { gamma: recipe.gamma };
    let mut result = Elimination {
        removed: vec![],
        change: vec![],
        kept: (0..x.cols()).collect(),
        decision_values: vec![],
        iterations: 0,
    };
    loop {
        let (x, held_out) = (columns_of(x, &result.kept), columns_of(held_out, &result.kept));
        let machine = train(&x, labels, kernel, Cost::balanced(recipe.c, labels), &EXACT).unwrap();
        result.decision_values.push((0..held_out.rows()).map(|i| machine.decision_value(held_out.row(i))).collect());
        if result.kept.len() == recipe.least {
            return result;
        }
        let norm = |left_out: Option<usize>| {
            let vectors = machine.support.iter().zip(&machine.coefficient);
            let mut sum = 0.0;
            for (a, alpha) in vectors.clone() {
                for (b, beta) in vectors.clone() {
                    let terms = a.iter().zip(b).enumerate().filter(|(f, _)| Some(*f) != left_out);
                    let distance: f64 = terms.map(|(_, (x, y))| (x - y) * (x - y)).sum();
                    sum += alpha * beta * (-recipe.gamma * distance).exp();
                }
            }
            sum
        };
        let change: Vec<f64> = (0..x.cols()).map(|f| (0.5 * (norm(None) - norm(Some(f)))).abs()).collect();
        let least = (0..change.len()).rev().min_by(|&a, &b| change[a].total_cmp(&change[b])).unwrap();
        result.removed.push(result.kept.remove(least));
        result.change.push(change[least]);
    }
}

fn assert_same(found: &Elimination, expected: &Elimination, name: &str) {
    assert_eq!(found.removed, expected.removed, "{name}");
    assert_eq!(found.kept, expected.kept, "{name}");
    for (a, b) in found.change.iter().zip(&expected.change) {
        assert!((a - b).abs() < 1e-4 * (1e-3 + b), "{name}: {a} {b}");
    }
    assert_eq!(found.decision_values.len(), expected.decision_values.len(), "{name}");
    for (a, b) in found.decision_values.iter().flatten().zip(expected.decision_values.iter().flatten()) {
        assert!((a - b).abs() < 1e-4, "{name}: {a} {b}");
    }
}

#[test]
fn agrees_with_the_plain_algorithm() {
    // gamma 20 and 2 make features too wide for single precision or many doublings, 0.01 none
    for (seed, gamma) in [(1, 0.01), (2, 0.1), (3, 2.0), (4, 20.0)] {
        let (x, labels, fold) = seasons(seed, 4, 40);
        let (test, training): (Vec<usize>, Vec<usize>) = (0..160).partition(|&row| fold[row] == 0);
        let labels: Vec<bool> = training.iter().map(|&row| labels[row]).collect();
        let (x, held_out) = (x.select_rows(&training), x.select_rows(&test));
        let recipe = EliminationRecipe { c: 1.5, gamma, least: 1 };
        let found = eliminate(&x, &labels, &held_out, &recipe, &EXACT, &Unobserved).unwrap();
        assert_same(&found, &plain(&x, &labels, &held_out, &recipe), &format!("seed {seed}, gamma {gamma}"));
        // a smaller demand is the beginning of a larger one
        let recipe = EliminationRecipe { least: 4, ..recipe };
        let part = eliminate(&x, &labels, &held_out, &recipe, &EXACT, &Unobserved).unwrap();
        assert_eq!(part.removed, found.removed[..3]);
        assert_eq!(part.decision_values, found.decision_values[..4]);
    }
}

/// What scikit-learn 1.9.1 and NumPy 2.4.6 print for:
/// ```python
/// i, j = np.arange(90)[:, None], np.arange(8)[None, :]
/// X = np.sin(1.7*i + 2.3*j*j + 0.5*i*j) + 0.3*np.cos(0.9*i*(j + 1))
/// z = 1.2*X[:,0] - 0.8*X[:,1] + 0.5*X[:,2]*X[:,3] + 0.7*np.sin(5.1*np.arange(90))
/// y = z > 0.4
/// train, test = slice(0, 60), slice(60, 90)
/// kept, gamma = list(range(8)), 0.2
/// while True:
///     svc = SVC(C=2, gamma=gamma, class_weight="balanced", tol=1e-10).fit(X[train][:, kept], y[train])
///     print(len(kept), svc.decision_function(X[test][:, kept])[[0, 10, 29]])
///     if len(kept) == 1: break
///     S, b = svc.support_vectors_, svc.dual_coef_[0]
///     H = np.exp(-gamma*((S[:, None] - S[None])**2).sum(-1))
///     dj = [abs(0.5*(b@H@b - b@(H*np.exp(gamma*np.subtract.outer(S[:, f], S[:, f])**2))@b)) for f in range(len(kept))]
///     print(kept.pop(int(np.argmin(dj))), min(dj))
/// ```
#[test]
fn agrees_with_scikit_learn() {
    let (x, labels) = eight_waves();
    let (training, test): (Vec<usize>, Vec<usize>) = ((0..60).collect(), (60..90).collect());
    let recipe = EliminationRecipe { c: 2.0, gamma: 0.2, least: 1 };
    let found = eliminate(
        &x.select_rows(&training),
        &labels[..60],
        &x.select_rows(&test),
        &recipe,
        &SolverOptions { epsilon: 1e-9, ..EXACT },
        &Unobserved,
    )
    .unwrap();
    assert_eq!(found.removed, [2, 5, 3, 6, 7, 1, 4]);
    let change = [
        0.002_201_864_848,
        0.711_362_199_496,
        0.816_799_487_758,
        0.649_658_724_797,
        1.079_208_064_867,
        1.847_548_409_673,
        1.949_795_451_170,
    ];
    for (a, b) in found.change.iter().zip(change) {
        assert!((a - b).abs() < 1e-5 * (1.0 + b), "{:?}", found.change);
    }
    let decision = [
        [-0.536_859_071_426, 0.326_854_336_71, 1.016_043_843_441],
        [-0.423_637_429_136, 0.425_411_918_384, 1.000_894_851_422],
        [-0.233_917_101_887, 0.394_361_908_542, 1.260_782_858_312],
        [-0.032_569_319_852, 0.231_613_197_011, 1.185_092_815_817],
        [-0.056_957_220_189, 0.136_908_342_937, 1.266_867_974_728],
        [-0.090_978_868_682, 0.247_683_237_364, 1.265_499_026_777],
        [1.154_771_353_017, -0.243_158_236_171, 0.828_096_161_618],
        [1.151_785_484_886, -0.218_149_445_495, 0.792_187_985_066],
    ];
    assert_eq!(found.decision_values.len(), decision.len());
    for (values, expected) in found.decision_values.iter().zip(decision) {
        let ours = [values[0], values[10], values[29]];
        assert!(ours.iter().zip(expected).all(|(a, b)| (a - b).abs() < 2e-5), "{ours:?} {expected:?}");
    }
}

#[test]
fn a_feature_that_says_nothing_goes_first_and_ties_go_to_the_last() {
    let (x, labels, _) = seasons(5, 3, 50);
    let data = (0..150).flat_map(|i| [&[0.0], x.row(i), &[0.0]].concat()).collect();
    let x = Matrix::from_rows(150, 9, data).unwrap();
    let recipe = EliminationRecipe { c: 1.0, gamma: 0.1, least: 6 };
    let none = Matrix::filled(0, 9, 0.0);
    let found = eliminate(&x, &labels, &none, &recipe, &SolverOptions::default(), &Unobserved).unwrap();
    assert_eq!(found.removed[..2], [8, 0]);
    assert_eq!(found.change[..2], [0.0, 0.0]);
    assert_eq!(found.kept.len(), 6);
    assert_eq!(found.decision_values, vec![Vec::<f64>::new(); 4]);
}

#[test]
fn same_bits_at_one_and_two_threads() {
    let (x, labels, _) = seasons(6, 5, 60);
    let recipe = EliminationRecipe { c: 1.0, gamma: 0.1, least: 1 };
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| eliminate(&x, &labels, &x, &recipe, &SolverOptions::default(), &Unobserved).unwrap())
    };
    assert_eq!(run(1), run(2));
}

/// Keeps what is reported and cancels at a fraction.
struct Watched(Mutex<Vec<f64>>, f64);

impl Progress for Watched {
    fn report(&self, fraction: f64, _: &str) {
        self.0.lock().unwrap().push(fraction);
    }

    fn cancelled(&self) -> bool {
        self.0.lock().unwrap().last().is_some_and(|&last| last >= self.1)
    }
}

#[test]
fn progress_rises_to_one_and_a_cancelled_run_ends() {
    let (x, labels, _) = seasons(7, 3, 40);
    let recipe = EliminationRecipe { c: 1.0, gamma: 0.1, least: 1 };
    let run = |stop_at| {
        let watched = Watched(Mutex::default(), stop_at);
        let result = eliminate(&x, &labels, &x, &recipe, &SolverOptions::default(), &watched);
        (result, watched.0.into_inner().unwrap())
    };
    let (result, told) = run(f64::INFINITY);
    assert!(result.is_ok() && told.is_sorted() && told.last() == Some(&1.0) && told.len() == 6, "{told:?}");
    let (result, told) = run(0.4);
    assert_eq!(result, Err(EliminationError::Cancelled));
    assert!(told.len() < 6);
}

#[test]
fn bad_input_is_an_error() {
    let (x, labels, _) = seasons(8, 2, 20);
    let recipe = EliminationRecipe { c: 1.0, gamma: 0.1, least: 1 };
    let with = |recipe: EliminationRecipe, options: &SolverOptions, held_out: &Matrix| {
        eliminate(&x, &labels, held_out, &recipe, options, &Unobserved).unwrap_err()
    };
    let options = SolverOptions::default();
    for least in [0, 8] {
        let error = with(EliminationRecipe { least, ..recipe }, &options, &x);
        assert_eq!(error, EliminationError::Size { least, features: 7 });
    }
    assert_eq!(
        with(EliminationRecipe { gamma: f64::NAN, ..recipe }, &options, &x),
        EliminationError::Input(SolverError::InvalidGamma)
    );
    assert!(matches!(
        with(EliminationRecipe { c: 0.0, ..recipe }, &options, &x),
        EliminationError::Input(SolverError::InvalidCost { .. })
    ));
    let narrow = Matrix::filled(3, 6, 0.0);
    assert!(matches!(with(recipe, &options, &narrow), EliminationError::Input(SolverError::LengthMismatch { .. })));
    let unknown = Matrix::filled(3, 7, f64::NAN);
    assert!(matches!(with(recipe, &options, &unknown), EliminationError::Input(SolverError::FeatureNotFinite { .. })));
    let little = SolverOptions { memory_limit_bytes: 1000, ..options };
    assert!(matches!(with(recipe, &little, &x), EliminationError::TooManyRows { rows: 40, .. }));
}
