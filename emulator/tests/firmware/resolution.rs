//! What the output converter's 12 bits leave of a position, with `dac.noise_shaping` and with plain rounding.

use std::rc::Rc;

use emulator::board::TickTruth;
use emulator::cpu::image::Image;
use emulator::time::SECOND;
use flexstage::GeneratorSettings;
use flexstage::settings::FeedbackSettings;

use crate::common::{armed, hold, image};

/// Positions of the three axes, um: codes are 4.7 nm apart, and none of these is on one.
const HOLDS_UM: [[f32; 3]; 3] =
    [[3.001, 4.003, 5.002], [5.004, 6.001, 7.003], [7.002, 8.004, 2.001]];

/// Distance of the stage's true position from the reference over the second after it has come to rest: rms, and rms about the
/// mean of each axis and hold, nm.
fn rest_nm(image: &Rc<Image>, shaping: bool, feedback: bool) -> (f64, f64) {
    let mut b = armed(image, 8, |s| {
        for axis in &mut s.axes {
            axis.dac.noise_shaping = shaping;
            if !feedback {
                axis.feedback = FeedbackSettings::default();
            }
        }
    });
    let (mut square, mut about_mean, mut holds) = (0.0, 0.0, 0.0);
    for places in HOLDS_UM {
        let waves: Vec<_> = (0u8..).zip(places.map(hold)).collect();
        b.start(&waves).unwrap();
        b.run_for(SECOND / 2).unwrap();
        b.board.0.borrow_mut().log = Some(Vec::new());
        b.run_for(SECOND).unwrap();
        let log = b.board.0.borrow_mut().log.take().unwrap();
        assert!(log.len() >= 9_999, "{} ticks", log.len());
        for (k, place) in places.into_iter().enumerate() {
            let n = log.len() as f64;
            let error_nm = |t: &TickTruth| 1e3 * (t.true_um[k] - f64::from(place));
            let mean = log.iter().map(error_nm).sum::<f64>() / n;
            let mean_square = log.iter().map(|t| error_nm(t).powi(2)).sum::<f64>() / n;
            square += mean_square;
            about_mean += mean_square - mean * mean;
            holds += 1.0;
        }
    }
    // Nothing moves at all with plain rounding and no feedback: what is left is rounding of the sums.
    ((square / holds).sqrt(), f64::max(about_mean / holds, 0.0).sqrt())
}

/// The same for a ramp so slow that it passes one code after the other, without feedback: rms about the mean, nm.
fn ramp_nm(image: &Rc<Image>, shaping: bool) -> f64 {
    let mut b = armed(image, 8, |s| {
        for axis in &mut s.axes {
            axis.dac.noise_shaping = shaping;
            axis.feedback = FeedbackSettings::default();
        }
    });
    b.start(&[(0, hold(5.0))]).unwrap();
    b.run_for(SECOND / 2).unwrap();
    // 7.5 V, 190 codes a micrometre.
    b.start(&[(0, GeneratorSettings::Ramp { target_um: 5.3, duration_s: 3.0 })]).unwrap();
    b.run_for(SECOND / 2).unwrap();
    b.board.0.borrow_mut().log = Some(Vec::new());
    b.run_for(2 * SECOND).unwrap();
    let log = b.board.0.borrow_mut().log.take().unwrap();
    // Straight: the line through the middles of the first and the last tenth is where a perfect converter would be.
    let mean =
        |part: &[TickTruth]| part.iter().map(|t| t.true_um[0]).sum::<f64>() / part.len() as f64;
    let tenth = log.len() / 10;
    let (first, last) = (mean(&log[..tenth]), mean(&log[log.len() - tenth..]));
    let slope = (last - first) / (log.len() - tenth) as f64;
    let middle = 0.5 * (tenth as f64 - 1.0);
    let square = log
        .iter()
        .enumerate()
        .map(|(i, t)| (1e3 * (t.true_um[0] - first - slope * (i as f64 - middle))).powi(2));
    (square.sum::<f64>() / log.len() as f64).sqrt()
}

#[test]
fn noise_shaping_holds_a_position_between_two_codes() {
    let Some(image) = image() else { return };
    let [plain, shaped] = [false, true].map(|shaping| ramp_nm(&image, shaping));
    println!(
        "slow ramp without feedback: {plain:.2} nm rms with plain rounding, {shaped:.2} nm with noise shaping"
    );
    for feedback in [false, true] {
        let [(plain, plain_moves), (shaped, shaped_moves)] =
            [false, true].map(|shaping| rest_nm(&image, shaping, feedback));
        println!(
            "at rest {} feedback: {plain:.2} nm rms from the reference ({plain_moves:.2} about the mean) with plain rounding, \
             {shaped:.2} nm ({shaped_moves:.2}) with noise shaping",
            if feedback { "with" } else { "without" }
        );
    }
    assert!(shaped < 0.5 * plain, "{shaped:.2} nm shaped, {plain:.2} nm plain");
}
