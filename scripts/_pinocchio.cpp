// Runs Pinocchio in C++ on a problem of the singular benchmark, for `_singular_codes.py`, which builds and calls this.
// A tree with CONTACT_3D, Baumgarte's stabilisation, and RK4; standard input describes the problem and the run.

#include <pinocchio/algorithm/constrained-dynamics.hpp>
#include <pinocchio/algorithm/loop-constrained-aba.hpp>

#include <ctime>
#include <iostream>
#include <string>
#include <vector>

using Vector = Eigen::VectorXd;
using Vector3 = Eigen::Vector3d;
using Constraints = PINOCCHIO_ALIGNED_STD_VECTOR(pinocchio::RigidConstraintModel);
using Constraint_data = PINOCCHIO_ALIGNED_STD_VECTOR(pinocchio::RigidConstraintData);

template<class Numbers>
static Numbers &read(Numbers &&x)
{
    for (Eigen::Index k = 0; k < x.size(); k++)
        std::cin >> x(k);
    return x;
}

static pinocchio::SE3 read_place()
{
    Vector3 at;
    return pinocchio::SE3(Eigen::Matrix3d::Identity(), read(at));
}

int main()
{
    pinocchio::Model model;
    Vector3 gravity;
    int bodies, closures, looped, points, each;
    double frequency, mu, h;
    std::cin >> looped >> frequency >> mu >> h >> points >> each;
    model.gravity.linear() = read(gravity);
    std::cin >> bodies;
    for (int k = 0; k < bodies; k++) { // the number of the parent, joint, axis, place, mass, centre, inertia
        std::size_t parent;
        std::string kind;
        Vector3 axis, center;
        Eigen::Matrix3d inertia;
        double mass;
        std::cin >> parent >> kind;
        read(axis);
        const pinocchio::SE3 at = read_place();
        std::cin >> mass;
        read(center);
        read(inertia.reshaped());
        const pinocchio::JointModel joint = kind == "revolute"
            ? pinocchio::JointModel(pinocchio::JointModelRevoluteUnaligned(axis))
            : pinocchio::JointModel(pinocchio::JointModelPrismaticUnaligned(axis));
        const auto made = model.addJoint(parent, joint, at, "joint" + std::to_string(k));
        model.appendBodyToJoint(made, pinocchio::Inertia(mass, center, inertia), pinocchio::SE3::Identity());
    }
    Constraints constraints;
    Constraint_data constraint_data;
    std::cin >> closures;
    for (int k = 0; k < closures; k++) { // joint and place on both sides
        std::size_t one, other;
        std::cin >> one;
        const pinocchio::SE3 first = read_place();
        std::cin >> other;
        const pinocchio::SE3 second = read_place();
        constraints.emplace_back(pinocchio::CONTACT_3D, model, one, first, other, second, pinocchio::LOCAL);
        constraints.back().m_baumgarte_parameters.Kp = frequency * frequency;
        constraints.back().m_baumgarte_parameters.Kd = 2 * frequency;
    }
    for (const auto &constraint : constraints)
        constraint_data.emplace_back(constraint);
    pinocchio::Data data(model);
    pinocchio::ProximalSettings settings(1e-12, 1e-12, mu, looped ? 10 : 5);
    const int n = model.nv;
    Vector y(2 * n), tau(n), k1(2 * n), k2(2 * n), k3(2 * n), k4(2 * n);
    read(y);
    read(tau);
    if (looped)
        pinocchio::computeJointMinimalOrdering(model, data, constraints);
    else
        pinocchio::initConstraintDynamics(model, data, constraints, constraint_data);
    const auto rate = [&](const Vector &at, Vector &found) {
        found.head(n) = at.tail(n);
        if (looped)
            found.tail(n) = pinocchio::lcaba(
                model, data, at.head(n), at.tail(n), tau, constraints, constraint_data, settings);
        else
            found.tail(n) = pinocchio::constraintDynamics(
                model, data, at.head(n), at.tail(n), tau, constraints, constraint_data, settings);
    };
    std::vector<Vector> states, forces;
    const std::clock_t begin = std::clock();
    for (int point = 0; point < points; point++) {
        for (int k = 0; k < (point ? each : 0); k++) {
            rate(y, k1);
            rate(y + h / 2 * k1, k2);
            rate(y + h / 2 * k2, k3);
            rate(y + h * k3, k4);
            y += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
        }
        if (!y.allFinite())
            break;
        states.push_back(y.head(n));
        if (!looped) {
            rate(y, k1);
            forces.push_back(data.lambda_c.head(3));
        }
    }
    std::cout << double(std::clock() - begin) / CLOCKS_PER_SEC << '\n';
    std::cout.precision(17);
    for (std::size_t k = 0; k < states.size(); k++) {
        std::cout << states[k].transpose();
        if (!looped)
            std::cout << ' ' << forces[k].transpose();
        std::cout << '\n';
    }
}
