//! Lumped masses that keep the kinetic energy of the moving links (section IV of the paper).
//!
//! Every link is a rigid body whose two ends move with known fractions of the velocities of the nodes it joins. A slender
//! uniform link whose ends move at u and v has the kinetic energy m (u² + u v + v²) / 6; a body that moves as a whole with
//! a node counts in full. The lumps are chosen such that, in the static shape of the chain, the sum of m_i v_i² / 2 is
//! the energy of all links; the mixed term u v is shared equally by both nodes.

/// A body that moves with the chain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Body {
    /// Moves as a whole with node `node` (1 is the first mass; the ground is 0 and carries no energy).
    Rigid {
        /// Node it moves with.
        node: usize,
        /// Its mass in kg.
        mass_kg: f64,
    },
    /// Uniform slender link between two neighbouring or distant nodes (0 is the ground).
    Link {
        /// Node at its inner end.
        from: usize,
        /// Node at its outer end.
        to: usize,
        /// Its mass in kg.
        mass_kg: f64,
    },
}

/// Velocity of each node over the velocity of the platform when the chain moves in its static shape: the sum of
/// compliances from the ground up to the node over the whole compliance. `stiffness_n_per_m` from the ground outwards.
pub fn static_shape(stiffness_n_per_m: &[f64]) -> Vec<f64> {
    let total: f64 = stiffness_n_per_m.iter().map(|k| 1.0 / k).sum();
    let mut sum = 0.0;
    stiffness_n_per_m
        .iter()
        .map(|k| {
            sum += 1.0 / k;
            sum / total
        })
        .collect()
}

/// Kinetic energy of the bodies for given node velocities (m/s), in J. Node 1 is `velocity[0]`.
pub fn kinetic_energy_j(bodies: &[Body], velocity_m_per_s: &[f64]) -> f64 {
    let at = |node: usize| if node == 0 { 0.0 } else { velocity_m_per_s[node - 1] };
    bodies
        .iter()
        .map(|body| match *body {
            Body::Rigid { node, mass_kg } => mass_kg * at(node).powi(2) / 2.0,
            Body::Link { from, to, mass_kg } => {
                let (u, v) = (at(from), at(to));
                mass_kg * (u * u + u * v + v * v) / 6.0
            }
        })
        .sum()
}

/// Lumped mass of every node (kg) such that the chain has the kinetic energy of the bodies when it moves in `shape`
/// (see [`static_shape`]; every entry positive). A node number beyond the shape counts as the platform.
pub fn lumped_masses_kg(bodies: &[Body], shape: &[f64]) -> Vec<f64> {
    let mut masses = vec![0.0; shape.len()];
    let index = |node: usize| node.min(shape.len());
    let mut add = |node: usize, mass_kg: f64| {
        if node > 0 {
            masses[node - 1] += mass_kg;
        }
    };
    for body in bodies {
        match *body {
            Body::Rigid { node, mass_kg } => add(index(node), mass_kg),
            Body::Link { from, to, mass_kg } => {
                let (from, to) = (index(from), index(to));
                let at = |node: usize| if node == 0 { 0.0 } else { shape[node - 1] };
                let (u, v) = (at(from), at(to));
                if u > 0.0 {
                    add(from, mass_kg * (1.0 + v / (2.0 * u)) / 3.0);
                }
                if v > 0.0 {
                    add(to, mass_kg * (1.0 + u / (2.0 * v)) / 3.0);
                }
            }
        }
    }
    masses
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn energy_is_kept_in_the_static_shape() {
        let stiffness = [6.0e3, 12.0e3, 9.0e3];
        let shape = static_shape(&stiffness);
        assert!((shape[2] - 1.0).abs() < 1e-15);
        let bodies = [
            Body::Link { from: 0, to: 1, mass_kg: 0.012 },
            Body::Link { from: 1, to: 2, mass_kg: 0.015 },
            Body::Link { from: 0, to: 3, mass_kg: 0.004 },
            Body::Rigid { node: 3, mass_kg: 0.02 },
        ];
        let masses = lumped_masses_kg(&bodies, &shape);
        let speed = 0.37;
        let lumped: f64 =
            masses.iter().zip(&shape).map(|(m, s)| m * (s * speed).powi(2) / 2.0).sum();
        let velocity: Vec<f64> = shape.iter().map(|s| s * speed).collect();
        let bodies_energy = kinetic_energy_j(&bodies, &velocity);
        assert!((lumped / bodies_energy - 1.0).abs() < 1e-12);
    }

    /// A link that turns about the ground acts at its far end with a third of its mass (textbook).
    #[test]
    fn link_about_the_ground_counts_a_third() {
        let masses = lumped_masses_kg(&[Body::Link { from: 0, to: 1, mass_kg: 0.03 }], &[1.0]);
        assert!((masses[0] - 0.01).abs() < 1e-15);
    }
}
