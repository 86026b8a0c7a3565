(define (problem problem_1)
  (:domain patrol)
  (:objects
    r2d2 - robot
    wp1 wp2 - waypoint
    dock - charging_point
  )
  (:init
    ( robot_at r2d2 dock )
    ( battery_low r2d2 )
    ( free r2d2 )
    ( connected dock wp1 )
    ( connected wp1 wp2 )
    ( connected wp1 dock )
  )
  (:goal
    ( and
      ( patrolled wp1 )
      ( patrolled wp2 )
    )
  )
)
